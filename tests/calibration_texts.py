"""Calibration files as programs write them, all of one camera of 32×24 pixels, and the lens that each tells of."""

from __future__ import annotations

from polarmap.geometry.distortion import Distortion

RADTAN = Distortion("radtan", (-0.1, 0.02, 0.001, -0.002))
RADTAN_5 = Distortion("radtan", (-0.1, 0.02, 0.001, -0.002, 0.0))
FISHEYE = Distortion("equidistant", (-0.1, 0.02, 0.001, -0.002))

OPENCV = """%YAML:1.0
---
image_width: 32
image_height: 24
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 24., 0., 15.25, 0., 24.5, 11.75, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -0.1, 2.0000000000000000e-02, 1e-3, -2e-3, 0. ]
"""
OPENCV_5 = OPENCV.replace("%YAML:1.0", "%YAML 1.2")
OPENCV_XML = """<?xml version="1.0"?>
<opencv_storage>
<image_width>32</image_width><image_height>24</image_height>
<Camera_Matrix type_id="opencv-matrix"><rows>3</rows><cols>3</cols><dt>d</dt>
  <data>24. 0. 15.25 0. 24.5 11.75 0. 0. 1.</data></Camera_Matrix>
<Distortion_Coefficients type_id="opencv-matrix"><rows>5</rows><cols>1</cols><dt>d</dt>
  <data>-0.1 0.02 0.001 -0.002 0.</data></Distortion_Coefficients>
</opencv_storage>
"""
OPENCV_JSON = """{
    "image_size": [ 32, 24 ],
    "camera_matrix": {"type_id": "opencv-matrix", "rows": 3, "cols": 3, "dt": "d",
        "data": [ 24.0, 0.0, 15.25, 0.0, 24.5, 11.75, 0.0, 0.0, 1.0 ]},
    "dist_coeffs": [[-0.1, 0.02, 0.001, -0.002, 0.0]]
}
"""
ROS = """image_width: 32
image_height: 24
camera_name: polcam
camera_matrix: {rows: 3, cols: 3, data: [24.0, 0.0, 15.25, 0.0, 24.5, 11.75, 0.0, 0.0, 1.0]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [-0.1, 0.02, 0.001, -0.002, 0.0]}
rectification_matrix: {rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}
projection_matrix: {rows: 3, cols: 4, data: [20, 0, 16, 0, 0, 20, 12, 0, 0, 0, 1, 0]}
"""
ROS_MESSAGE = """header: {frame_id: camera}
height: 24
width: 32
distortion_model: rational_polynomial
d: [-0.1, 0.02, 0.001, -0.002, 0.0, 0.0, 0.0, 0.0]
k: [24.0, 0.0, 15.25, 0.0, 24.5, 11.75, 0.0, 0.0, 1.0]
binning_x: 0
roi: {x_offset: 0, y_offset: 0, height: 0, width: 0, do_rectify: false}
"""
KALIBR = """cam0:
  cam_overlaps: []
  camera_model: pinhole
  distortion_coeffs: [-0.1, 0.02, 0.001, -0.002]
  distortion_model: radtan
  intrinsics: [24.0, 24.5, 15.25, 11.75]
  resolution: [32, 24]
  rostopic: /polcam/image_raw
"""
EUROC = """sensor_type: camera
T_BS: {cols: 4, rows: 4, data: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]}
rate_hz: 20
resolution: [32, 24]
camera_model: pinhole
intrinsics: [24.0, 24.5, 15.25, 11.75]
distortion_model: radial-tangential
distortion_coefficients: [-0.1, 0.02, 0.001, -0.002]
"""
ORB_SLAM = """%YAML:1.0
# a comment
File.version: "1.0"
Camera.type: "PinHole"
Camera1.fx: 24.0
Camera1.fy: 24.5
Camera1.cx: 15.25
Camera1.cy: 11.75
Camera1.k1: -0.1
Camera1.k2: 0.02
Camera1.p1: 0.001
Camera1.p2: -0.002
Camera.width: 32
Camera.height: 24
Camera.fps: 20
ORBextractor.nFeatures: 1000
"""
ORB_SLAM_FISHEYE = """%YAML:1.0
Camera.type: "KannalaBrandt8"
Camera.fx: 24.0
Camera.fy: 24.5
Camera.cx: 15.25
Camera.cy: 11.75
Camera.k1: -0.1
Camera.k2: 0.02
Camera.k3: 0.001
Camera.k4: -0.002
"""
STELLA = """Camera.name: "x"
Camera.model: "perspective"
Camera.fx: 24.0
Camera.fy: 24.5
Camera.cx: 15.25
Camera.cy: 11.75
Camera.cols: 32
Camera.rows: 24
"""
VINS = """%YAML:1.0
---
model_type: PINHOLE
camera_name: camera
image_width: 32
image_height: 24
distortion_parameters: {k1: -0.1, k2: 0.02, p1: 1.0e-03, p2: -0.002}
projection_parameters: {fx: 24.0, fy: 24.5, cx: 15.25, cy: 11.75}
"""
VINS_FISHEYE = """%YAML:1.0
---
model_type: KANNALA_BRANDT
image_width: 32
image_height: 24
projection_parameters: {k2: -0.1, k3: 0.02, k4: 0.001, k5: -0.002, mu: 24.0, mv: 24.5, u0: 15.25, v0: 11.75}
"""
COLMAP = "# Camera list\n#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n"
COLMAP_OPENCV = COLMAP + "1 OPENCV 32 24 24 24.5 15.75 12.25 -0.1 0.02 0.001 -0.002\n"
COLMAP_FISHEYE = COLMAP + "1 OPENCV_FISHEYE 32 24 24 24.5 15.75 12.25 -0.1 0.02 0.001 -0.002\n"
COLMAP_PINHOLE = COLMAP + "3 PINHOLE 32 24 24 24.5 15.75 12.25\n"

FILES = {
    "opencv": (OPENCV, RADTAN_5),
    "opencv 5": (OPENCV_5, RADTAN_5),
    "opencv xml": (OPENCV_XML, RADTAN_5),
    "opencv json": (OPENCV_JSON, RADTAN_5),
    "opencv fisheye": (OPENCV.replace("rows: 5", "rows: 4").replace(", 0. ]\n", " ]\nfisheye_model: 1\n"), FISHEYE),
    "ros": (ROS, RADTAN_5),
    "ros fisheye": (
        ROS.replace("plumb_bob", "equidistant").replace("cols: 5", "cols: 4").replace("-0.002, 0.0]", "-0.002]"),
        FISHEYE,
    ),
    "ros message": (ROS_MESSAGE, Distortion("radtan", (*RADTAN.coefficients, 0.0, 0.0, 0.0, 0.0))),
    "kalibr": (KALIBR, RADTAN),
    "kalibr fisheye": (KALIBR.replace("radtan", "equidistant"), FISHEYE),
    "euroc": (EUROC, RADTAN),
    "orb-slam3": (ORB_SLAM, RADTAN_5),
    "orb-slam2 fisheye": (ORB_SLAM_FISHEYE, FISHEYE),
    "stella_vslam": (STELLA, None),
    "vins": (VINS, RADTAN),
    "vins fisheye": (VINS_FISHEYE, FISHEYE),
    "colmap": (COLMAP_OPENCV, RADTAN),
    "colmap fisheye": (COLMAP_FISHEYE, FISHEYE),
    "colmap pinhole": (COLMAP_PINHOLE, None),
}
