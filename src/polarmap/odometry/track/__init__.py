"""Tracking: the pose of each frame against the newest keyframe."""
