"""Gains, angles and efficiencies of four channels by least squares: I = g t/2 (1 + e cos 2(θ - φ)).

g, e, φ are a channel's, θ and t a picture's: the angle of the polarizer before the lens, and the light that it passes.
A flat field of unpolarized light has no cosine. The gains are 1 on average. The common offset of all angles is free
unless θ is known absolutely; it is taken such that the channels' angles are right on average.

If every t is free and θ is not known, there are other gains and efficiencies with which the same means come of other t
and θ (those that a diattenuator before the sensor would make). A flat field excludes them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq, least_squares

from polarmap.data.polarizers import LABELS, PolarizerCalibration
from polarmap.errors import InputError

_NOMINAL = np.radians(LABELS)
_SURE = 1e7  # weight of what is so by convention
_ROUNDS = 4  # of fit and scatter
_WORST_ANGLE, _WORST_SHARE = 1.0, 0.02  # degrees, and share of a gain or efficiency, that a standard error may be
_FIRST_EFFICIENCY = 0.97
_MOST_SCATTER = 0.1
_SIGNIFICANT = 4.0  # standard deviations of χ²


@dataclass(frozen=True, eq=False)
class Light:
    """A picture: means of the four labelled channels as shares of full scale, float64 4, and their variances.

    turned: whether it was taken through a polarizer. angle: that polarizer's in radians, turning as labels do, None
    where it is not known.
    """

    name: str
    means: np.ndarray
    variances: np.ndarray
    turned: bool = False
    angle: float | None = None


@dataclass(frozen=True, eq=False)
class PolarizerFit:
    """What came of it.

    values: of the channels labelled 0, 45, 90 and 135 degrees, float64 3×4: angles in degrees, gains, efficiencies.
    errors: their standard errors, float64 3×4; 0 for what was not fitted.
    names, polarizer_angles: the pictures through a polarizer, and its angles in degrees in [0, 180).
    residuals: rms of each picture's misfit as a share of its brightness, in the order of `all_names`.
    scatter: rms of what noise does not explain, as a share of brightness. spare: by how many measurements the law of
        Malus is tried.
    """

    values: np.ndarray
    errors: np.ndarray
    names: tuple[str, ...]
    polarizer_angles: tuple[float, ...]
    all_names: tuple[str, ...]
    residuals: tuple[float, ...]
    scatter: float
    spare: int

    @property
    def calibration(self) -> PolarizerCalibration:
        """For the camera file. Raises InputError where no polarizers can be like that."""
        return PolarizerCalibration(*(_four(row) for row in self.values))

    def require_sure(self) -> None:
        """Raise InputError where a standard error is too large for a calibration."""
        angle, share = self.errors[0].max(), self.errors[1:].max()
        if angle > _WORST_ANGLE or share > _WORST_SHARE:
            raise InputError(f"{_undetermined()} (standard errors: {angle:.2g} degrees, {share:.1%})")


def apparent_angle(light: Light, gains: np.ndarray) -> tuple[float, float]:
    """Angle in radians, turning as labels do, and degree of polarization, as four ideal polarizers would see them."""
    i0, i45, i90, i135 = light.means / gains
    s0, s1, s2 = 0.5 * (i0 + i45 + i90 + i135), i0 - i90, i45 - i135
    return 0.5 * float(np.arctan2(s2, s1)), float(np.hypot(s1, s2) / s0)


def fit_polarizers(pictures: Sequence[Light], absolute: bool = False) -> PolarizerFit:
    """The least-squares solution, with standard errors by noise and by the scatter that noise does not explain.

    pictures: flat fields and pictures through a polarizer, whose angles are known of all or of none. absolute: known
    angles count from the direction labelled 0, else from anywhere. Raises InputError where they do not determine it.
    """
    problem = _Problem(pictures, absolute)
    variances = np.concatenate([picture.variances for picture in pictures])
    brightness = np.repeat([picture.means.mean() for picture in pictures], 4)
    redundancy = variances.size - problem.unknowns
    if redundancy < 0:
        raise InputError(f"{variances.size} measurements do not determine {problem.unknowns} unknowns; add pictures")
    scatter, values = 0.0, problem.start()
    for _ in range(_ROUNDS):
        sigma = np.sqrt(variances + (scatter * brightness) ** 2)
        values, covariance = problem.solve(values, sigma)
        found = _scatter(problem.misfit(values), variances, brightness, redundancy, problem.spare)
        if abs(found - scatter) <= 0.02 * found:
            break
        scatter = found
    return _fit(problem, values, covariance, scatter, brightness)


def _scatter(misfit: np.ndarray, variances: np.ndarray, brightness: np.ndarray, redundancy: int, spare: int) -> float:
    """Share of brightness that, added to the noise, makes χ² what it should be; 0 where noise suffices.

    Where χ² is surely too large, the law of Malus is what fails, which only `spare` of the measurements can show: the
    others say no more than that four channels see three numbers.
    """

    def chi2(scatter: float) -> float:
        return float(np.sum(misfit**2 / (variances + (scatter * brightness) ** 2)))

    if redundancy == 0 or chi2(0.0) <= redundancy:
        return 0.0
    surely = chi2(0.0) > redundancy + _SIGNIFICANT * np.sqrt(2.0 * redundancy)
    expected = max(spare, 1) if surely and spare < redundancy else redundancy
    if chi2(_MOST_SCATTER) >= expected:
        return _MOST_SCATTER
    return float(brentq(lambda scatter: chi2(scatter) - expected, 0.0, _MOST_SCATTER))


class _Problem:
    """Unknowns: gains, then if there are pictures through a polarizer angles and efficiencies; log t of each picture;
    each θ that is not known, or their common offset."""

    def __init__(self, pictures: Sequence[Light], absolute: bool) -> None:
        self.pictures = tuple(pictures)
        self.turned = np.array([picture.turned for picture in pictures])
        self.polarized = bool(self.turned.any())
        known = [picture.angle for picture in pictures if picture.turned and picture.angle is not None]
        self.known = np.array(known) if self.polarized and len(known) == self.turned.sum() else None
        self.absolute = absolute and self.known is not None
        self.means = np.stack([picture.means for picture in pictures])

    @property
    def unknowns(self) -> int:
        """How many of them there are, less what is so by convention."""
        return self.start().size - 1 - (self.polarized and not self.absolute)

    @property
    def spare(self) -> int:
        """How many measurements are left to try the law of Malus by.

        Of the map from Stokes parameters to channels, 9 numbers within the channels' own space, the common gain and
        rotation are free, and a flat field tells two. A picture through a polarizer tells one more, that its light is
        wholly polarized, and another if its angle is known.
        """
        turned = int(self.turned.sum())
        if not turned:
            return 3 * int((~self.turned).sum()) - 3
        told = 2 * bool((~self.turned).any()) + turned * (1 if self.known is None else 2)
        return told - (7 if self.known is None else 8)

    def start(self) -> np.ndarray:
        gains = self._first_gains()
        light = np.log(np.maximum(2.0 * (self.means / gains).mean(axis=1), 1e-6))
        if not self.polarized:
            return np.concatenate([gains, light])
        turned = [picture for picture in self.pictures if picture.turned]
        seen = np.array([apparent_angle(picture, gains)[0] for picture in turned])
        angles = [*_NOMINAL, *np.full(4, _FIRST_EFFICIENCY)]
        if self.known is None:
            return np.concatenate([gains, angles, light, seen])
        offset = 0.5 * np.angle(np.exp(2j * (seen - self.known)).mean())
        return np.concatenate([gains, angles, light, [] if self.absolute else [offset]])

    def _first_gains(self) -> np.ndarray:
        flat = self.means[~self.turned]
        if not flat.size:
            return np.ones(4)
        shares = (flat / flat.mean(axis=1, keepdims=True)).mean(axis=0)
        return shares / shares.mean()

    def parts(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Gains, angles φ, efficiencies, light of each picture, and θ of each through a polarizer."""
        gains, rest = values[:4], values[4:]
        phi, efficiencies = _NOMINAL, np.ones(4)
        if self.polarized:
            phi, efficiencies, rest = rest[:4], rest[4:8], rest[8:]
        light, rest = np.exp(rest[: len(self.pictures)]), rest[len(self.pictures) :]
        if self.known is None:
            return gains, phi, efficiencies, light, rest
        return gains, phi, efficiencies, light, self.known + (0.0 if self.absolute else rest[0])

    def misfit(self, values: np.ndarray) -> np.ndarray:
        """Predicted less measured means, float64 4 a picture, one after the other."""
        gains, phi, efficiencies, light, theta = self.parts(values)
        wave = np.zeros((len(self.pictures), 4))
        wave[self.turned] = efficiencies * np.cos(2.0 * (theta[:, None] - phi))
        return (0.5 * light[:, None] * gains * (1.0 + wave) - self.means).ravel()

    def solve(self, start: np.ndarray, sigma: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The solution and its covariance."""

        def residuals(values: np.ndarray) -> np.ndarray:
            gains, phi, *_ = self.parts(values)
            conventions = [_SURE * (gains.mean() - 1.0)]
            if self.polarized and not self.absolute:
                conventions.append(_SURE * (phi - _NOMINAL).mean())
            return np.concatenate([self.misfit(values) / sigma, conventions])

        found = least_squares(residuals, start, jac="3-point", x_scale="jac", xtol=1e-14, ftol=1e-14, gtol=1e-14)
        scale = np.linalg.norm(found.jac, axis=0)
        if not np.all(scale > 0):
            raise InputError(_undetermined())
        singular, right = np.linalg.svd(found.jac / scale, full_matrices=False)[1:]
        if singular[-1] < 1e-7 * singular[0]:
            raise InputError(_undetermined())
        inverse = (right.T / singular) / scale[:, None]
        return found.x, inverse @ inverse.T


def _fit(
    problem: _Problem,
    values: np.ndarray,
    covariance: np.ndarray,
    scatter: float,
    brightness: np.ndarray,
) -> PolarizerFit:
    gains, phi, efficiencies, _, theta = problem.parts(values)
    variances = np.diag(covariance)
    errors = np.zeros((3, 4))
    errors[1] = np.sqrt(variances[:4])
    if problem.polarized:
        errors[0], errors[2] = np.degrees(np.sqrt(variances[4:8])), np.sqrt(variances[8:12])
    share = (problem.misfit(values) / brightness).reshape(-1, 4)
    return PolarizerFit(
        values=np.stack([np.degrees(phi), gains, efficiencies]),
        errors=errors,
        names=tuple(picture.name for picture in problem.pictures if picture.turned),
        polarizer_angles=tuple(float(angle) for angle in np.degrees(theta) % 180.0),
        all_names=tuple(picture.name for picture in problem.pictures),
        residuals=tuple(float(rms) for rms in np.sqrt((share**2).mean(axis=1))),
        scatter=scatter,
        spare=problem.spare,
    )


def _four(values: np.ndarray) -> tuple[float, float, float, float]:
    first, second, third, fourth = (float(value) for value in values)
    return first, second, third, fourth


def _undetermined() -> str:
    return (
        "the pictures do not determine the polarizers; turn the polarizer to more angles, spread over 180 degrees, and "
        "add a flat field"
    )
