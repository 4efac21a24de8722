"""A point cloud that says of each point how sure it is and how it reflects."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from polarmap.export.output import prepare_file, remarks
from polarmap.export.samples import choose_samples
from polarmap.export.source import MapSource
from polarmap.io.formats.ply import write_ply

_PROPERTIES = (
    "sigma: standard deviation of the depth along the optical axis",
    "confidence: 0 to 1",
    "label: kind of reflection, 0 none, 1 diffuse, 2 specular, 3 metal",
    "keyframe: index of the frame that the point is of",
)


def export_cloud(
    source: MapSource, out: Path, *, points: int = 1_000_000, min_confidence: float = 0.1, force: bool = False
) -> int:
    """Write the file `out`, *.ply, binary; returns the number of points.

    points: at most so many, chosen as in `choose_samples`. Raises InputError as `prepare_file` does, and where there
    are no keyframes.
    """
    prepare_file(out, ".ply", force)
    samples = choose_samples(source, points, min_confidence)
    write_ply(
        out,
        samples.position,
        normals=samples.normal,
        grey=samples.grey / np.float32(255.0),
        properties={
            "sigma": samples.sigma,
            "confidence": samples.confidence,
            "label": samples.label,
            "keyframe": samples.keyframe,
        },
        offset=source.origin,
        comments=(*remarks(source), *_PROPERTIES),
    )
    return len(samples)
