"""ROS bags as recordings: ROS 1 `.bag`, and ROS 2 in SQLite or MCAP. Needs the extra `bags` (rosbags).

recognize    what is a bag
bag          topics and messages of one
encodings    how image messages store pixels
images       the frames of an image topic
camera       the camera file of a topic, also by its camera_info
poses        trajectories from messages of poses and from transforms
transforms   the tree of coordinate frames in tf and tf_static
stamped      times and poses in messages
opening      a recording of all this
"""
