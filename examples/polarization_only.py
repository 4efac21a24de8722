"""Degree and angle of polarization of one frame, with their noise: python examples/polarization_only.py SEQUENCE"""

import sys

import numpy as np

from polarmap import FrontEnd, open_sequence

sequence = open_sequence(sys.argv[1])
front_end = FrontEnd(sequence.camera_file)
image = front_end.polarization(sequence[0])
print(f"median DoLP {np.median(image.dolp):.3f}")
print(f"AoLP known to 10 degrees in {(image.sigma_aolp < np.radians(10)).mean():.0%} of the pixels")
