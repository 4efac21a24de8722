"""The README's picture of glossy things: polarmap synth scene things S, python docs/images/make_things.py S

A picture, normals as polarization has them (made unambiguous by the map), those of the map, and the mesh.
"""

import sys
from pathlib import Path

import cv2
import numpy as np

from polarmap import Mapper, open_sequence, read_trajectory
from polarmap.data.mesh import Mesh
from polarmap.geometry.surface import normals_from_cues
from polarmap.polarization.alone import clearly_polarized
from polarmap.report import pictures
from polarmap.report.preview import render_view

SIZE = (640, 480)
FARTHEST = 1.1  # of the median depth, what the mesh's picture shows

folder = Path(sys.argv[1])
sequence = open_sequence(folder)
keyframes = []
mapper = Mapper(sequence.camera_file, read_trajectory(folder / "groundtruth.txt"), on_keyframe=keyframes.append)
for frame in sequence:
    mapper.process(frame)
mesh = mapper.finish().mesh
keyframe = keyframes[len(keyframes) // 2]
polarized = normals_from_cues(keyframe.azimuth, keyframe.zenith, keyframe.camera)
polarized[~clearly_polarized(keyframe.image)] = np.nan
R, t = keyframe.T_world_camera[:3, :3], keyframe.T_world_camera[:3, 3]
camera, local = keyframe.camera, (mesh.vertices - t) @ R
u, v = (local @ camera.matrix.T)[:, :2].T / local[:, 2]
shown = (local[:, 2] > 0) & (local[:, 2] < FARTHEST * np.nanmedian(keyframe.depth))
shown &= (u > 0) & (u < camera.width) & (v > 0) & (v < camera.height)
used, faces = np.unique(mesh.faces[shown[mesh.faces].all(axis=1)], return_inverse=True)
near = Mesh(mesh.vertices[used], faces.reshape(-1, 3).astype(np.int32), mesh.normals[used], mesh.grey[used])
mesh_view = render_view(near, R.T, near.vertices[:1], SIZE)
panels = [
    pictures.grey(keyframe.image.intensity, float(np.percentile(keyframe.image.intensity, 99))),
    pictures.normals(polarized.astype(np.float32)),
    pictures.normals(keyframe.normal),
    mesh_view,
]
panels = [cv2.resize(panel, SIZE, interpolation=cv2.INTER_AREA) for panel in panels]
figure = cv2.resize(pictures.montage(panels, columns=2), None, fx=0.75, fy=0.75, interpolation=cv2.INTER_AREA)
cv2.imwrite(str(Path(__file__).with_name("things.jpg")), figure[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 85])
