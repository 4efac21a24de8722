"""The start of a map: from two views with parallax, before anything is known.

corner_tracks  corners of a first frame, followed through later ones
epipolar       the motion between two images of which pixels are matched
two_view       motion and depth of corners from two views, or why there is none yet
direct         two frames aligned directly, which refines the former, or does alone where there are few corners
starter        takes frames until one of the two ways makes a start
"""
