"""The paper's loop."""
