"""What a run leaves in its folder (docs/output.md)."""
