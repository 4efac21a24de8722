"""Whether a network known by its name alone gives what the name says: depth, or inverse depth.

Names are no proof: metric and relative networks are published under nearly the same ones. Read the wrong way round, a
network's order of depths is that of the sparse points inverted.
"""

from __future__ import annotations

import logging

import numpy as np

from polarmap.prior.alignment import PriorAlignment, Verdict
from polarmap.prior.network import DepthNetwork
from polarmap.prior.network_spec import OutputSpace

log = logging.getLogger(__name__)

_ENOUGH = 2  # keyframes more for the other way than for the one in use


class SpaceCheck:
    """Reads a network the other way round once that has fitted `_ENOUGH` keyframes more than the way in use.

    swapped: whether it is read otherwise than by its name.
    """

    def __init__(self, network: DepthNetwork) -> None:
        self._network = network
        self._surplus = 0
        self.swapped = False

    def read(self, relative: np.ndarray) -> np.ndarray:
        """Relative inverse depth the way in use; `relative` is that by the name."""
        return other_way(relative) if self.swapped else relative

    def note(self, in_use: PriorAlignment, other: PriorAlignment | None) -> None:
        """What became of a keyframe's alignments, both ways; None where the other way was not tried.

        Switches, and says so in one line, where there is enough for the other way.
        """
        if in_use.accepted:
            self._surplus = max(self._surplus - 1, 0)
        elif in_use.verdict is Verdict.INVERTED and other is not None and other.accepted:
            self._surplus += 1
        if self._surplus >= _ENOUGH:
            self._surplus, self.swapped = 0, not self.swapped
            self._say()

    def _say(self) -> None:
        by_name_depth = self._network.spec.output_space is OutputSpace.DEPTH
        before, now = OutputSpace.DEPTH.value, OutputSpace.INVERSE_DEPTH.value
        if by_name_depth != self.swapped:
            before, now = now, before
        log.warning(
            "%s: was taken for %s by its name, but the stereo points fit it as %s, as which it is read from now on; "
            "say which it is with output_space in %s",
            self._network.path,
            before,
            now,
            self._network.path.with_suffix(".yaml"),
        )


def other_way(relative: np.ndarray) -> np.ndarray:
    """Depth for inverse depth and the reverse, NaN where that has none, float32, same shape."""
    valid = relative > 0
    return np.where(valid, 1.0 / np.where(valid, relative, 1.0), np.nan).astype(np.float32)
