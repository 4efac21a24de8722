"""Figures that the paper printed, to stand beside measured ones and never to be taken for them.

Source: M. Shakeri, S. Y. Loo, H. Zhang, "Polarimetric Monocular Dense Mapping Using Relative Deep Depth Prior", IEEE
Robotics and Automation Letters, 2021: the tables of Section IV, in the order in which they stand there. None where
the paper prints a dash: the method lost track.
"""

from __future__ import annotations

MARK = "published"
"""What is written beside every figure of this module."""

METHODS = ("LSD-SLAM", "SVO", "DSO", "paper's method")

SEQUENCES = {
    "living-room-kt0": "Living room kt0",
    "living-room-kt1": "Living room kt1",
    "office-kt1": "Office room kt1",
    "office-kt3": "Office room kt3",
}
"""The paper's sequences, made from ICL-NUIM: names for a spec, and titles."""

ABS_REL = {
    "living-room-kt0": (0.1573, None, 0.0864, 0.0713),
    "living-room-kt1": (0.1447, 0.1299, 0.0868, 0.0602),
    "office-kt1": (0.1274, None, 0.0791, 0.0720),
    "office-kt3": (0.2108, 0.1622, 0.0776, 0.0793),
}
"""AbsRel by sequence, of each of `METHODS`."""

POINTS_PER_IMAGE = (96673, 284, 1402, 162784)
"""Average number of points per 640×480 image over all sequences, of each of `METHODS`."""

PIXELS = 640 * 480
"""Pixels of the images that `POINTS_PER_IMAGE` and `ABLATION` count in."""

ABLATION_SEQUENCE = "living-room-kt1"
ABLATION = {
    "sparse": (0.0868, 1485),
    "inliers": (0.0315, 10362),
    "first": (0.0587, 125996),
    "final": (0.0602, 159237),
}
"""AbsRel and average points per image after each step; "sparse" are DSO's points, "final" is iteration 7."""

POINTS = {
    "Lab1": (192978, 237, 494, 370288),
    "Lab3": (182931, 186, 654, 804179),
}
"""Reconstructed points of the real sequences, of each of `METHODS`; their images have 1224×1024 pixels."""
