"""Cameras on a cable: what they send becomes frames (`live_camera`) or a recording (`recorder`)."""
