"""Mapping without files: images, poses and a camera as arrays, here from the built-in simulator."""

from polarmap import Mapper, PinholeCamera
from polarmap.data.frame import Frame
from polarmap.sensing.front_end import FrontEnd
from polarmap.synth import Sensor, built_in_scene, render_sequence
from polarmap.synth.recording import camera_file

camera = PinholeCamera(width=240, height=180, fx=180.0, fy=180.0, cx=119.5, cy=89.5)
room = built_in_scene("room")
timestamps, poses = room.path(frames=10)
sensor = Sensor()
front_end = FrontEnd(camera_file(camera, sensor))

mapper = Mapper(camera)
for f in render_sequence(room.scene, camera, timestamps, poses, sensor, supersample=1):
    image = front_end.polarization(Frame(f.index, f.timestamp, "simulated", path=None, mosaic=f.mosaic))
    mapper.process_image(image, f.T_world_camera, f.timestamp, f.index)
result = mapper.finish()
print(f"{result.keyframes} keyframes, {result.blocks} blocks of voxels of {1000 * result.voxel_size:.0f} mm")
