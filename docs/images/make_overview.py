"""The README's picture from a demo: python docs/images/make_overview.py out/demo"""

import sys
from pathlib import Path

import cv2
import numpy as np

from polarmap import FrontEnd, open_sequence
from polarmap.report import pictures

FRAME = 8

demo = Path(sys.argv[1])
sequence = open_sequence(demo / "sequence")
image = FrontEnd(sequence.camera_file).polarization(sequence[FRAME])
with np.load(demo / "map" / "keyframes" / f"{FRAME:06d}.npz", allow_pickle=False) as keyframe:
    limits = pictures.depth_limits(keyframe["depth"])
    panels = [
        pictures.grey(image.intensity, float(np.percentile(image.intensity, 99))),
        pictures.polarization(image.aolp, image.dolp, 0.2),
        pictures.depth(keyframe["inliers"], limits),
        pictures.depth(keyframe["depth"], limits),
        pictures.normals(keyframe["normal"]),
        pictures.origins(keyframe["origin"]),
    ]
overview = cv2.resize(pictures.montage(panels, columns=3), None, fx=0.6, fy=0.6, interpolation=cv2.INTER_AREA)
cv2.imwrite(str(Path(__file__).with_name("overview.jpg")), overview[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 88])
