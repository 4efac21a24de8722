"""Sequences × methods × seeds, measured by the same code, as tables beside the paper's own."""
