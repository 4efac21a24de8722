"""Reading and writing files: sequences, camera files, trajectories, images. Nothing below touches a file."""

from polarmap.io.camera_file import CameraFile, read_camera_file, write_camera_file
from polarmap.io.depth_png import depth_png_scale, read_depth_png, write_depth_png
from polarmap.io.sequence import Frame, Sequence, open_sequence
from polarmap.io.trajectory import Trajectory, read_trajectory, write_trajectory

__all__ = [
    "CameraFile",
    "Frame",
    "Sequence",
    "Trajectory",
    "depth_png_scale",
    "open_sequence",
    "read_camera_file",
    "read_depth_png",
    "read_trajectory",
    "write_camera_file",
    "write_depth_png",
    "write_trajectory",
]
