"""A sensor's calibration from pictures: which of them can be used, and what they tell together."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from polarmap.data.camera_file import CameraFile
from polarmap.data.frame import Frame
from polarmap.errors import InputError
from polarmap.sensing.calibration.channel_means import ChannelMeans, channel_means
from polarmap.sensing.calibration.polarizer_fit import Light, PolarizerFit, apparent_angle, fit_polarizers
from polarmap.sensing.front_end import require_polarization

_CLIPPED = 1e-4  # share of pixels
_BRIGHTEST_DARK = 0.1  # of full scale
_DARKEST = 0.02  # of full scale, above black
_CUT_BLACK = 0.2  # share of pixels at 0, from which the mean of a dark picture is too high
_UNEVEN = 0.5  # how much darker a part may be than another
_MIXED = 0.03  # rms of a channel's share of the brightness over the picture
_FLAT = 0.15  # share by which a channel of a flat field may differ from the mean
_POLARIZED = 0.5  # DoLP behind a polarizer
_DIFFERENT = 3.0  # degrees between two angles that count as two
_SPREAD = 60.0  # degrees, of 180, that the largest gap between angles leaves at least
_FEWEST_UNKNOWN, _FEWEST_KNOWN, _FEWEST_WITH_FLAT = 6, 5, 4  # pictures, of which one or two try the law of Malus
_AGREEING = 0.98  # length of the mean of exp 2i(seen - known)
_MISFIT = 0.04  # rms of a picture, share of brightness
_LEFT_OUT = 0.25  # share of the pictures
_UNEXPLAINED = 0.002  # scatter, share of brightness, from which a picture is suspected
_SUSPECTS = 5  # pictures with the largest misfits
_BETTER = 3.0  # times less scatter without a picture that contradicts the others
_LEAST_SPARE = 5  # measurements that try the law of Malus, of which a picture takes one or two


@dataclass(frozen=True, eq=False)
class SensorCalibration:
    """camera_file: the one given, with what was measured. black_error: standard error of the black level in pixel
    values, None where it was not measured. fit: of the polarizers, None where only black was. left_out: names of
    pictures that contradict all others. notes: what the user should know, in lines."""

    camera_file: CameraFile
    black_error: float | None
    fit: PolarizerFit | None
    left_out: tuple[str, ...]
    notes: tuple[str, ...]


def calibrate_sensor(
    camera_file: CameraFile,
    dark: Iterable[Frame] = (),
    flat: Iterable[Frame] = (),
    turned: Iterable[Frame] = (),
    angles: Sequence[float] | None = None,
    absolute: bool = False,
) -> SensorCalibration:
    """Black level by dark pictures, gains by flat fields of unpolarized light, all else by those through a polarizer.

    angles: degrees of the polarizer in each of `turned`, turning as the camera file's labels do; None where they are
    not known. absolute: they count from the direction labelled 0, else from wherever the mount has its zero.
    The middle of each picture is used, half of each side. Raises InputError where a picture is clipped, too dark or not
    what it is said to be, or where they do not determine what is asked.
    """
    require_polarization(camera_file)
    darks, flats, turns = ([channel_means(frame, camera_file) for frame in frames] for frames in (dark, flat, turned))
    if not (darks or flats or turns):
        raise InputError("nothing to calibrate with; give dark pictures, flat fields, or pictures through a polarizer")
    notes: list[str] = []
    black_error = None
    if darks:
        black, black_error = _black(darks, camera_file, notes)
        camera_file = replace(camera_file, black_level=black)
    lights = [*_lights(flats, camera_file), *_lights(turns, camera_file, turned=True)]
    if not lights:
        return SensorCalibration(camera_file, black_error, None, (), tuple(notes))
    if not turns:
        notes.append(
            "only gains: angles and efficiencies need pictures through a polarizer, and nothing shows whether the flat "
            "field's light is polarized, which would be taken for gains"
        )
    if turns and not darks and camera_file.black_level == 0:
        notes.append("black level 0 is taken for true; if it is not, efficiencies come out low: give dark pictures")
    _check_flat(lights)
    lights = _with_angles(lights, angles, absolute)
    fit, left_out = _robust(lights, absolute)
    calibrated = replace(camera_file, polarizers=fit.calibration)
    return SensorCalibration(calibrated, black_error, fit, left_out, tuple(notes))


def _black(darks: Sequence[ChannelMeans], camera_file: CameraFile, notes: list[str]) -> tuple[float, float]:
    values = np.stack([each.values for each in darks])
    for each in darks:
        if each.values.max() > _BRIGHTEST_DARK * camera_file.white_level:
            raise InputError(f"{each.name}: {each.values.max():.4g} is no black; put the lens cap on for --dark")
    if np.mean([each.zero for each in darks]) > _CUT_BLACK:
        notes.append("many dark pixels are 0: noise is cut off below; raise the camera's own black level if it has one")
    pictures, noise = values.mean(axis=1), np.mean([each.variances.mean() for each in darks])
    spread = pictures.var(ddof=1) if len(darks) > 1 else 0.0
    error = np.sqrt(max(spread, noise / 4.0) / len(darks))
    return float(values.mean()), float(error)


def _lights(pictures: Sequence[ChannelMeans], camera_file: CameraFile, turned: bool = False) -> list[Light]:
    lights = []
    for picture in pictures:
        if picture.clipped > _CLIPPED:
            raise InputError(f"{picture.name}: {picture.clipped:.2%} of its middle is saturated; expose it shorter")
        means, variances = picture.light(camera_file.black_level, camera_file.white_level)
        if means.mean() < _DARKEST:
            raise InputError(f"{picture.name}: {means.mean():.1%} of full scale is too dark; expose it longer")
        _check_even(picture, camera_file.black_level)
        lights.append(Light(picture.name, means, variances, turned))
    return lights


def _check_even(picture: ChannelMeans, black: float) -> None:
    darker, spread = picture.unevenness(black)
    if darker > _UNEVEN or spread > _MIXED:
        how = (
            f"its darkest part is {darker:.0%} darker"
            if darker > _UNEVEN
            else f"its channels' shares vary by {spread:.1%}"
        )
        raise InputError(
            f"{picture.name}: the middle is not even ({how}); picture white paper or opal glass that fills the view, "
            "out of focus, and let the polarizer cover the lens"
        )


def _check_flat(lights: Sequence[Light]) -> None:
    for light in lights:
        differing = np.abs(light.means / light.means.mean() - 1.0).max()
        if not light.turned and differing > _FLAT:
            raise InputError(
                f"{light.name}: its channels differ by {differing:.0%}, so that its light is polarized; use an "
                "overcast sky overhead, an integrating sphere, or white paper lit from all sides, without a polarizer"
            )


def _with_angles(lights: list[Light], angles: Sequence[float] | None, absolute: bool) -> list[Light]:
    turned = [light for light in lights if light.turned]
    flat = [light for light in lights if not light.turned]
    if angles is not None and len(angles) != len(turned):
        raise InputError(f"--angles: {len(angles)} angles for {len(turned)} pictures through a polarizer")
    if absolute and angles is None:
        raise InputError("--absolute is for known angles; give --angles")
    if not turned:
        return lights
    seen = np.array([_angle_seen(light) for light in turned])
    if angles is None:
        if not flat:
            raise InputError(
                "without a flat field, pictures through a polarizer at unknown angles do not tell gains from light; "
                "give --flat, or the angles as --angles"
            )
        _check_spread(np.degrees(seen), _FEWEST_UNKNOWN)
        return lights
    known = np.radians(np.asarray(angles, np.float64))
    _check_known(turned, seen, known)
    _check_spread(np.degrees(known), _FEWEST_WITH_FLAT if flat else _FEWEST_KNOWN)
    return [*flat, *(replace(light, angle=float(angle)) for light, angle in zip(turned, known, strict=True))]


def _angle_seen(light: Light) -> float:
    angle, dolp = apparent_angle(light, np.ones(4))
    if dolp < _POLARIZED:
        raise InputError(
            f"{light.name}: its light is hardly polarized (degree {dolp:.2f}); the polarizer has to cover the lens"
        )
    return angle


def _check_spread(angles: np.ndarray, fewest: int) -> None:
    """At least `fewest` angles that differ, spread over the half turn."""
    ordered = np.sort(angles % 180.0)
    gaps = np.diff(ordered, append=ordered[0] + 180.0)
    different, extent = int(np.count_nonzero(gaps > _DIFFERENT)), 180.0 - float(gaps.max())
    if different >= fewest and extent >= _SPREAD:
        return
    how = f"stand at {different} different angles" if different < fewest else f"lie within {extent:.0f} degrees"
    raise InputError(
        f"the {len(angles)} pictures through a polarizer {how}, which does not determine the channels; take {fewest} "
        "or more, better 8 to 12, spread over 180 degrees"
    )


def _check_known(turned: Sequence[Light], seen: np.ndarray, known: np.ndarray) -> None:
    agreeing, mirrored = (abs(np.exp(2j * (seen - sign * known)).mean()) for sign in (1, -1))
    if agreeing >= _AGREEING:
        return
    if mirrored >= _AGREEING:
        raise InputError(
            "--angles: they turn against the pictures; give them with the other sign (-30 for 30) if the mount counts "
            "the other way than the camera's angle_direction, or correct angle_direction"
        )
    offset = np.angle(np.exp(2j * (seen - known)).mean())
    away = np.degrees(np.abs(np.angle(np.exp(2j * (seen - known) - 1j * offset))) / 2)
    worst = int(away.argmax())
    raise InputError(
        f"--angles: they do not agree with the pictures; {turned[worst].name} is {away[worst]:.0f} degrees off. They "
        "have to be in the order of the pictures' names"
    )


def _robust(lights: list[Light], absolute: bool) -> tuple[PolarizerFit, tuple[str, ...]]:
    """The fit without pictures that contradict all others, which are named; InputError where too many do."""
    most = int(_LEFT_OUT * len(lights))
    left_out: list[str] = []
    fit = fit_polarizers(lights, absolute)
    while len(left_out) < most and fit.scatter > _UNEXPLAINED and fit.spare >= _LEAST_SPARE:
        without = _without_one(lights, fit, absolute)
        culprit = min(without, key=lambda i: without[i].scatter, default=None)
        if culprit is None or without[culprit].scatter * _BETTER > fit.scatter:
            break
        left_out.append(lights[culprit].name)
        lights, fit = [*lights[:culprit], *lights[culprit + 1 :]], without[culprit]
    _check_fit(fit)
    return fit, tuple(left_out)


def _without_one(lights: Sequence[Light], fit: PolarizerFit, absolute: bool) -> dict[int, PolarizerFit]:
    """The fits without one of the pictures that are farthest from it, by the picture's place, where there is a fit."""
    fits = {}
    for place in np.argsort(fit.residuals)[: -_SUSPECTS - 1 : -1]:
        with suppress(InputError):
            fits[int(place)] = fit_polarizers([*lights[:place], *lights[place + 1 :]], absolute)
    return fits


def _check_fit(fit: PolarizerFit) -> None:
    worst = int(np.argmax(fit.residuals))
    if fit.residuals[worst] > _MISFIT:
        raise InputError(
            f"{fit.all_names[worst]}: {fit.residuals[worst]:.1%} off the law of Malus; light that changes, angles that "
            "were misread (leave --angles out), or a wrong black level (--dark) may be why"
        )
    fit.require_sure()
    try:
        _ = fit.calibration
    except InputError as problem:
        raise InputError(
            f"what was fitted cannot be: {problem}; look at mosaic, angle_direction and black_level of the camera file"
        ) from None
