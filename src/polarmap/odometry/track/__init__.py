"""Tracking: the pose of each frame against the newest keyframe.

motion   guesses of the motion, by what the last frames did or by matched corners
tracker  direct alignment from such a guess, coarse to fine
"""
