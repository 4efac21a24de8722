"""Whether a picture is fit to be mapped: neither black nor clipped, torn, blurred or noise, as far as one can see.

A picture is judged by itself (no light, nothing but clipped pixels, nothing but noise) and against those before it.
What is unusual but lasts is no fault: a light was switched on, or the recording is like this.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from enum import Enum

import cv2
import numpy as np

from polarmap.data.sensor import SensorNoise
from polarmap.sensing.frame_look import FrameLook, FrameLooker, cell_means

_MEMORY = 5  # pictures that a new one is compared with
_GAP = 5.0  # of the usual time between pictures; after a longer one they need not resemble each other

_NEARLY_ALL = 0.98  # of the picture
_MUCH = 0.2  # of the picture that goes dark or clips at once
_UNSTRUCTURED, _STRUCTURED = 1.8, 2.5  # see `FrameLook.structure`
_UNCORRELATED = 0.3  # see `FrameLook.correlation`
_NOISY = 4.0  # times the standard deviation that is expected
_LEAST_CONTRAST = 20.0  # below which noise hides whether a picture is sharp
_BLURRED = 0.5  # of the usual sharpness
_TORN, _TORN_ANEW = 0.1, 3.2  # share of columns, and times the share in the picture before
_LOOKED_BACK = 3  # pictures in which a texture that lies along a row would have shown before
_LEAST_TEAR = 0.03  # share of columns that textures may reach by chance
_TEAR_MOVES = 0.1  # of the picture's height, how far a row of texture may move from one picture to the next
_FLASH = math.log(2.0)  # of ln(brightness ratio)
_FLASH_ANEW = 4.0  # times the usual |ln(brightness ratio)|
_BANDS = 4  # of the picture that are looked for in the next one
_LEAST_VARIATION = 0.03  # of a band's mean brightness
_CHANGED, _CHANGED_AT_FIRST = 0.15, 0.4  # see `mismatch`; the latter where nothing is known of what is usual
_UNCHANGED, _LEAST_CHANGE = 0.03, 4.0  # mismatch that is nothing, and times the usual one
_PATCH = 64  # pixels of the picture that are looked for in the next one
_SAME_PLACE = 0.4  # correlation that noise does not reach


class Fault(Enum):
    """What is wrong with a picture, as it is said.

    severe: it cannot be tracked either. patience: pictures in a row that are left out for it, before it is taken as
    the way that the recording now is; None where it never is.
    """

    BLACK = "the picture is black", True, None
    CLIPPED = "the picture is saturated", True, None
    NOISE = "the picture is nothing but noise", True, None
    BLANK = "the picture shows nothing, unlike those before it", True, 10
    PARTLY_BLACK = "a part of the picture has gone black", True, 10
    PARTLY_CLIPPED = "a part of the picture has become saturated", True, 10
    TORN = "the picture is torn: it is put together from two", False, 3
    CHANGED = "the picture shows something else than those before it", False, 3
    NOISIER = "the picture is far noisier than those before it", False, 10
    BLURRED = "the picture is blurred, unlike its neighbours", False, 10
    FLASH = "the picture is far brighter or darker than its neighbours", False, 3

    def __init__(self, text: str, severe: bool, patience: int | None) -> None:
        self.text, self.severe, self.patience = text, severe, patience


@dataclass(frozen=True)
class Verdict:
    """Of a picture. fault: what is wrong with it, if anything. earlier: the index of one that was taken before and has
    turned out to be the odd one, with its fault; only the first one can.
    """

    fault: Fault | None = None
    earlier: tuple[int, Fault] | None = None


class FrameCheck:
    """Judges the pictures of a recording one by one.

    noise, bit_depth: the sensor's. valid: bool H×W, the pixels that the lens shows, all if None.
    """

    def __init__(self, noise: SensorNoise, bit_depth: int, valid: np.ndarray | None = None) -> None:
        self._look = FrameLooker(noise, bit_depth, valid)
        self._fit: deque[FrameLook] = deque(maxlen=_MEMORY)
        self._steps: deque[float] = deque(maxlen=_MEMORY)  # |ln(brightness ratio)| between those
        self._changes: deque[float] = deque(maxlen=_MEMORY)  # `mismatch` between them
        self._change = 0.0  # from the last fit picture to this one
        self._left_out: FrameLook | None = None  # the last picture, if it was
        self._in_a_row = 0  # left out for being unlike others
        self._first = 0  # index of the first of those that are fit
        self._picture: np.ndarray | None = None  # the last one
        self._clock = _Rhythm()

    def judge(
        self, intensity: np.ndarray, index: int, timestamp: float = math.nan, exposure: float | None = None
    ) -> Verdict:
        """The verdict on the next picture.

        intensity: float32 H×W, a share of full scale. index: names it. timestamp: seconds, NaN if not known. exposure:
        its exposure time in any unit, None or NaN if not known, by which brightness may rightly change.
        """
        look = self._look(intensity)
        if self._clock.is_gap(timestamp):
            self._forget()
        fault = self._by_itself(look, intensity)
        verdict = Verdict(fault) if fault else self._among_others(look, exposure)
        self._picture = intensity
        self._note(look, index, verdict, exposure)
        return verdict

    def _forget(self) -> None:
        """What comes now need not resemble what was."""
        for what in (self._fit, self._steps, self._changes):
            what.clear()
        self._left_out = None

    def _by_itself(self, look: FrameLook, intensity: np.ndarray) -> Fault | None:
        if look.dark_share > _NEARLY_ALL and look.structure < _UNSTRUCTURED:
            return Fault.BLACK
        if look.clipped_share > _NEARLY_ALL:
            return Fault.CLIPPED
        noise = look.structure < _UNSTRUCTURED and look.correlation < _UNCORRELATED
        if not noise or look.variance < (_NOISY * look.expected_noise) ** 2:
            return None
        usual = any(other.correlation < _UNCORRELATED for other in self._fit)
        return None if usual or self._recurs(intensity) else Fault.NOISE

    def _recurs(self, intensity: np.ndarray) -> bool:
        """Whether the last picture shows the same, if moved: fine gravel looks like noise, but noise comes anew."""
        if self._picture is None or self._picture.shape != intensity.shape:
            return False
        height, width = (min(side // 2, _PATCH) for side in intensity.shape)
        y, x = (intensity.shape[0] - height) // 2, (intensity.shape[1] - width) // 2
        patch = self._picture[y : y + height, x : x + width]
        around = intensity[max(y - _PATCH, 0) : y + height + _PATCH, max(x - _PATCH, 0) : x + width + _PATCH]
        return float(cv2.matchTemplate(around, patch, cv2.TM_CCOEFF_NORMED).max()) > _SAME_PLACE

    def _among_others(self, look: FrameLook, exposure: float | None) -> Verdict:
        if not self._fit:
            return Verdict()
        self._change = mismatch(look, self._fit[-1])
        fault = self._worse(look, list(self._fit), exposure)
        if len(self._fit) == 1:
            return self._against_the_first(look, fault)
        if fault and self._in_a_row >= fault.patience:
            self._forget()
            return Verdict()
        return Verdict(fault)

    def _against_the_first(self, look: FrameLook, fault: Fault | None) -> Verdict:
        """Of two pictures that differ the worse one is at fault, or that with which a third one does not agree."""
        first = self._worse(self._fit[0], [look], None)
        if fault is None and first in (None, Fault.FLASH, Fault.CHANGED):
            return Verdict()
        if fault is not None:
            third = self._left_out
            if third is None or self._worse(look, [third], None) or self._worse(third, [look], None):
                return Verdict(fault)
        self._forget()
        return Verdict(earlier=(self._first, first or fault))

    def _worse(self, look: FrameLook, others: list[FrameLook], exposure: float | None) -> Fault | None:
        last = others[-1]
        if look.structure < _UNSTRUCTURED and last.structure > _STRUCTURED:
            return Fault.BLANK
        for fault, name in ((Fault.PARTLY_BLACK, "dark"), (Fault.PARTLY_CLIPPED, "clipped")):
            if _new_share(look, last, name) > _MUCH:
                return fault
        if _is_torn(look, others[-_LOOKED_BACK:]):
            return Fault.TORN
        if self._is_changed(look, others):
            return Fault.CHANGED
        if look.noise > _NOISY * max(look.expected_noise, *(other.noise for other in others)):
            return Fault.NOISIER
        if _is_blurred(look, others):
            return Fault.BLURRED
        return Fault.FLASH if self._is_flash(look, last, exposure) else None

    def _is_changed(self, look: FrameLook, others: list[FrameLook]) -> bool:
        """Whether a band of the picture resembles the last one far less than is usual here."""
        if others[-1] is not self._fit[-1]:
            return mismatch(look, others[-1]) > _CHANGED_AT_FIRST
        usual = _LEAST_CHANGE * max(_UNCHANGED, *self._changes) if self._changes else _CHANGED_AT_FIRST
        return self._change > max(usual, _CHANGED)

    def _is_flash(self, look: FrameLook, last: FrameLook, exposure: float | None) -> bool:
        return self._brightness_step(look, last, exposure) > max(_FLASH, _FLASH_ANEW * max(self._steps, default=0.0))

    def _brightness_step(self, look: FrameLook, last: FrameLook, exposure: float | None) -> float:
        """|ln(brightness ratio)|, of which a change of the exposure time explains what it can."""
        step = math.log(max(look.mean, 1e-6) / max(last.mean, 1e-6))
        explained = self._clock.exposure_step(exposure)
        return min(abs(step), abs(step - explained))

    def _note(self, look: FrameLook, index: int, verdict: Verdict, exposure: float | None) -> None:
        fault = verdict.fault
        odd = fault is not None and fault.patience is not None
        self._in_a_row = self._in_a_row + 1 if odd else 0
        self._left_out = look if odd else None
        if fault:
            return
        self._first = self._first if self._fit else index
        if self._fit:
            self._steps.append(self._brightness_step(look, self._fit[-1], exposure))
            self._changes.append(self._change)
        self._fit.append(look)
        self._clock.exposure = exposure


class _Rhythm:
    """When pictures come, and how long the last fit one was exposed."""

    def __init__(self) -> None:
        self.exposure: float | None = None
        self._last = math.nan
        self._periods: deque[float] = deque(maxlen=9)

    def is_gap(self, timestamp: float) -> bool:
        """Whether the picture comes so late that it may well show something else."""
        period = timestamp - self._last
        self._last = timestamp
        if not period > 0:
            return False
        gap = bool(self._periods) and period > _GAP * float(np.median(self._periods))
        self._periods.append(period)
        return gap

    def exposure_step(self, exposure: float | None) -> float:
        """ln of the ratio of exposure times, 0 where one is not known."""
        before = self.exposure
        if not before or not exposure or not (before > 0 and exposure > 0 and math.isfinite(before * exposure)):
            return 0.0
        return math.log(exposure / before)


def _new_share(look: FrameLook, last: FrameLook, name: str) -> float:
    """Of the cells: those that are dark (or clipped) and far from any that were."""
    before = cv2.dilate(getattr(last, name).view(np.uint8), np.ones((5, 5), np.uint8)).view(bool)
    return float((getattr(look, name) & ~before)[look.known].mean())


def mismatch(look: FrameLook, last: FrameLook) -> float:
    """1 - normalized correlation of two successive pictures in that horizontal band where they differ most.

    Either may be moved against the other by a twelfth of its width. Bands without contrast in the last one are left
    out: there is nothing to be found again.
    """
    now, before = (cv2.blur(cell_means(each.cells, 2), (3, 3)) for each in (look, last))
    moves = max(before.shape[1] // 12, 1)
    rows = before.shape[0] // _BANDS
    padded = cv2.copyMakeBorder(now, moves, moves, 0, 0, cv2.BORDER_REPLICATE)
    worst = 0.0
    for top in range(0, rows * _BANDS, rows) if rows else ():
        band, found = before[top : top + rows, moves:-moves], padded[top : top + rows + 2 * moves]
        if band.std() < _LEAST_VARIATION * max(float(band.mean()), last.expected_noise):
            continue
        same = float(cv2.matchTemplate(found, band, cv2.TM_CCOEFF_NORMED).max()) if found.std() > 1e-5 else 0.0
        worst = max(worst, 1.0 - same)
    return worst


def _is_torn(look: FrameLook, others: list[FrameLook]) -> bool:
    """Whether a row has a tear where there was nothing like it before, nearby."""
    if look.tear.size == 0 or look.tear.max() <= _TORN:
        return False
    before = np.maximum(np.max([other.tear for other in others], axis=0), _LEAST_TEAR)
    reach = 2 * int(_TEAR_MOVES * look.tear.size) + 1
    nearby = cv2.dilate(before[:, None], np.ones((reach, 1), np.uint8)).ravel()
    return bool(((look.tear > _TORN) & (look.tear > _TORN_ANEW * nearby)).any())


def _is_blurred(look: FrameLook, others: list[FrameLook]) -> bool:
    usual = [other for other in others if other.contrast > _LEAST_CONTRAST]
    if not usual or look.contrast < _LEAST_CONTRAST:
        return False
    sharpness, fine = (float(np.median([getattr(o, name) for o in usual])) for name in ("sharpness", "fine"))
    return look.sharpness < _BLURRED * sharpness and look.fine < _BLURRED * fine
