"""The recording in a ROS bag: `for frame in open_bag("recording.mcap"): ...`"""

from __future__ import annotations

from pathlib import Path

from polarmap.io.recording.ros.bag import Bag
from polarmap.io.recording.ros.camera import CameraSource, find_camera
from polarmap.io.recording.ros.images import BagSequence, FrameReader, find_images


def open_bag(path: Path | str, topic: str | None = None, camera: CameraSource | None = None) -> BagSequence:
    """The frames of an image topic in a ROS bag; nothing but their times is kept in memory.

    path: a `.bag` of ROS 1, a folder of ROS 2 with its metadata.yaml, or a single `.mcap` or `.db3` of it.
    topic: of sensor_msgs/Image, or of CompressedImage with PNG files; the only one if None.
    Needs the extra `bags`. Raises InputError where the bag, the topic or the camera cannot be used.
    """
    path = Path(path)
    bag = Bag(path)
    try:
        images = find_images(bag, topic)
        camera_file = find_camera(bag, images, camera or CameraSource())
        reader = FrameReader(bag, images.name)
        sequence = BagSequence(path, camera_file, images.frames, reader, images.name, images.frame_id)
        _ = sequence[0]  # what cannot be used is said before anything is begun
    except BaseException:
        bag.close()
        raise
    return sequence
