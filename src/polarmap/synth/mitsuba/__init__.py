"""Scenes of the Mitsuba 3 renderer as polarization sequences, with full polarized light transport.

Mitsuba is an extra: nothing here imports it before a scene is loaded.
"""
