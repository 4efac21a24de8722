"""Camera calibrations as other programs write them, recognized by their content.

opencv       OpenCV's FileStorage as YAML, XML or JSON
ros          camera_info, as a file or a printed message
kalibr       Kalibr's camchain.yaml
euroc        sensor.yaml of the ASL data set format
orb_slam     settings of ORB-SLAM2, ORB-SLAM3 and stella_vslam
camodocal    camera files of camodocal and VINS-Fusion
colmap       COLMAP's cameras.txt

They know the lens and nothing of polarizers; `camera_file_values` puts the two together.
"""

from polarmap.io.recording.calibration.conversion import camera_file_values, camera_info_values
from polarmap.io.recording.calibration.lens_models import lens_distortion
from polarmap.io.recording.calibration.sensor import CAMERA_FILE_NAME, find_camera_file

__all__ = ["CAMERA_FILE_NAME", "camera_file_values", "camera_info_values", "find_camera_file", "lens_distortion"]
