"""Map a recording from Python: python examples/map_sequence.py SEQUENCE TRAJECTORY"""

import sys

from polarmap import Mapper, open_sequence, read_trajectory

sequence = open_sequence(sys.argv[1])
mapper = Mapper(sequence.camera_file, read_trajectory(sys.argv[2]))
for frame in sequence:
    keyframe = mapper.process(frame)
    if keyframe is not None:
        print(f"keyframe {keyframe.index}: depth for {keyframe.density:.0%} of the pixels")
result = mapper.finish()
print(f"{result.keyframes} keyframes, {0 if result.mesh is None else len(result.mesh.faces)} triangles")
