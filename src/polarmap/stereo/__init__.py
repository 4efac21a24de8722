"""Multi-view stereo: depth of a keyframe where there is texture."""
