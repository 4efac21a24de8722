"""A finished map for the programs that go on with it (docs/export.md)."""
