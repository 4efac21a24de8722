"""PatchMatch with slanted planes."""
