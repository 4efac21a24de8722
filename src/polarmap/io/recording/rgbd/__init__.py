"""RGB-D recordings with poses: ICL-NUIM, TUM RGB-D, Redwood/Open3D and Replica-style folders, read alike."""

from polarmap.io.recording.rgbd.formats import FORMATS, open_rgbd
from polarmap.io.recording.rgbd.pose_check import reprojection_error
from polarmap.io.recording.rgbd.recording import RgbdFiles, RgbdFrame, RgbdSequence

__all__ = ["FORMATS", "RgbdFiles", "RgbdFrame", "RgbdSequence", "open_rgbd", "reprojection_error"]
