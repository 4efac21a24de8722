"""Direct sparse odometry (DSO: Engel, Koltun, Cremers 2016), from the bottom to the top:

    options, pattern, pyramid, points, selection, keyframe_rule, records    what all else stands on
    start       the first two keyframes: motion and depth from two views
    track       the pose of each frame against a keyframe
    window      the keyframes that are adjusted together, and their points
    keyframing  what happens when a frame becomes a keyframe: `window`, from a start of `start`
    back_end    what is done with a frame once its pose is known: `keyframing`, and aligning frames again
    local_map   one segment of the map: `track` on top of `back_end`
    odometry    images in, poses out: starts, follows, gives up and begins anew
    side_by_side  the same with the back end on a thread of its own

`start`, `track` and `window` do not know each other.
"""
