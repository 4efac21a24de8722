"""Depth priors: relative depth networks aligned to sparse points, or the points themselves interpolated."""
