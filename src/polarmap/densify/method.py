"""What a method of densification is: from a view's sparse points to depth everywhere."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from polarmap.data.cues import Cues
from polarmap.data.dense_depth import DenseDepth
from polarmap.data.keyframe import CueBeliefs
from polarmap.data.plane_field import PlaneField
from polarmap.data.view import Neighbour, Sighting, View
from polarmap.geometry.camera import PinholeCamera
from polarmap.prior.priors import PriorDepth
from polarmap.timing import StepClock


@dataclass(frozen=True, eq=False)
class SparseView:
    """All that is known of a view before it is dense.

    points: stereo's inliers, float32 H×W z, NaN where none. planes: all that stereo found. prior: of the whole view.
    neighbours: views that new depth must not contradict. sightings: what these and earlier ones have surely seen.
    known_planes: those that the keyframe before was made of (`View.planes`), in this one's frame; None where there are
    none.
    """

    view: View
    camera: PinholeCamera
    points: np.ndarray
    planes: PlaneField
    prior: PriorDepth
    neighbours: tuple[Neighbour, ...] = ()
    sightings: tuple[Sighting, ...] = ()
    known_planes: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class Densified:
    """Dense depth of a view, the cues to its normals, and how far these were believed.

    planes: that hold a good part of the view, float64 N×3 as in `View.planes`; None where the method finds none.
    """

    dense: DenseDepth
    cues: Cues
    beliefs: CueBeliefs
    planes: np.ndarray | None = None


class Densifier(Protocol):
    """Spreads sparse depth over a view."""

    def __call__(self, sparse: SparseView, clock: StepClock) -> Densified:
        """Dense depth of a view. clock: takes the time of its steps, "densify" and "cues".

        Raises InputError where a shape is not the camera's.
        """
        ...
