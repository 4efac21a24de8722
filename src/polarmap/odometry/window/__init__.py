"""The window of keyframes that are adjusted together, and their points."""
