"""Odometry without files: images as arrays in, poses and sparse points out, here of a rendered room."""

import numpy as np

from polarmap import Odometry, PinholeCamera
from polarmap.evaluation.metrics import trajectory_metrics
from polarmap.synth import built_in_scene, render_sequence

camera = PinholeCamera(width=320, height=240, fx=240.0, fy=240.0, cx=159.5, cy=119.5)
room = built_in_scene("room")
timestamps, poses = room.path(frames=14)

odometry = Odometry(camera)
for frame in render_sequence(room.scene, camera, timestamps, poses, supersample=1):
    grey = (
        frame.mosaic.reshape(240, 2, 320, 2).mean(axis=(1, 3), dtype=np.float32) / 255
    )  # any image in [0, 1] would do
    update = odometry.process(grey, frame.timestamp, frame.index)
    print(f"frame {frame.index}: {update.status.value}{update.reason and ', ' + update.reason}")
odometry.finish()

result = odometry.result()
found = np.array([frame.T_world_camera[:3, 3] for frame in result.frames])
error = trajectory_metrics(found, np.array([poses[frame.index][:3, 3] for frame in result.frames]))
print(f"{len(result.frames)} poses, {len(result.points.position)} points")
print(f"position error {1000 * error.similar:.1f} mm; a unit of odometry is {error.scale:.2f} m")
