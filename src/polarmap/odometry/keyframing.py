"""The back end: what happens when a frame becomes a keyframe (DSO, section 3)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from polarmap.geometry.camera import PinholeCamera
from polarmap.odometry.options import OdometryOptions
from polarmap.odometry.points import ActivePoints, describe, new_immature
from polarmap.odometry.pyramid import Pyramid
from polarmap.odometry.selection import PointSelector
from polarmap.odometry.start.direct import Start
from polarmap.odometry.window.activation import Activator
from polarmap.odometry.window.adjustment import Adjusted, adjust
from polarmap.odometry.window.marginalization import marginalize_keyframe, marginalize_points
from polarmap.odometry.window.residuals import GOOD, NONE
from polarmap.odometry.window.tracing import GONE
from polarmap.odometry.window.window import KeyframeState, Projection, Window, project

_MIN_SHARE = 0.05  # of a keyframe's points still in use; below it the keyframe leaves
_MAX_BRIGHTNESS_CHANGE = 0.7  # of ln(brightness) against the newest keyframe
_MIN_INFORMATION = 50.0  # of an inverse depth that is worth to be kept in the prior
_MIN_GOOD = 4  # residuals of a point that is worth it
_KEPT_NEWEST = 2  # keyframes that never leave (DSO, section 3.1)
_FIRST_ITERATIONS = 30  # of the adjustment of the first two keyframes, whose depths are rough
_MORE_ITERATIONS = {2: 3.0, 3: 2.5, 4: 2.0}  # factor of the usual number, by how many keyframes there are
_LEAST_DISTANCE = 1e-5  # length, where the mean inverse depth is about 1; epsilon of DSO's equation 20


_Frame = tuple[int, Pyramid, float]


class KeyframeMapper:
    """Holds the window: adds keyframes, activates points, adjusts, marginalizes.

    on_points_gone: called with the active points that leave for good, while their hosts are in the window.
    """

    def __init__(
        self,
        camera: PinholeCamera,
        options: OdometryOptions,
        seed: int,
        on_points_gone: Callable[[ActivePoints], None],
        valid: np.ndarray | None = None,
    ) -> None:
        self._options = options
        self.window = Window(camera, options.keyframes + 1)
        self._selector = PointSelector(options.gradient_threshold, seed, valid)
        self._activator = Activator(options)
        self._on_points_gone = on_points_gone

    def begin(self, first: _Frame, second: _Frame, start: Start) -> Adjusted:
        """Two first keyframes, (index, pyramid, exposure) each, and the start that they gave."""
        window, options = self.window, self._options
        host = window.add(first[0], first[1].levels[0], np.eye(4), np.zeros(2), first[2])
        affine = np.array([np.log(start.gain * first[2] / second[2]), start.offset])
        target = window.add(second[0], second[1].levels[0], start.T_second_first, affine, second[2])
        keep = _thinned(len(start.pixels), options.points)
        pixels, inverse_depth = start.pixels[keep], start.inverse_depth[keep]
        color, weight, _ = describe(first[1].levels[0], pixels.astype(int), options.gradient_constant)
        count = len(pixels)
        state = np.full((count, window.capacity), NONE, np.uint8)
        state[:, target.slot] = GOOD
        window.points = ActivePoints(
            np.full(count, host.slot, np.int32), pixels.astype(np.float32), inverse_depth.astype(np.float32), color,
            weight, state, np.zeros(count, np.float32), np.zeros(count, np.int32),
        )  # fmt: skip
        host.chosen = count
        adjusted = adjust(window, options, _FIRST_ITERATIONS)
        target.relinearize()
        self._remove_unseen()
        self._choose(host, first[1], taken=window.points.pixel.astype(int))
        self._choose(target, second[1])
        return adjusted

    def add(
        self, index: int, pyramid: Pyramid, T_camera_world, affine, exposure: float
    ) -> tuple[Adjusted, list[KeyframeState]]:
        """Make a tracked frame a keyframe; immature points must have been traced in it already.

        Returns the keyframes that left the window too.
        """
        window, options = self.window, self._options
        leaving = self._leaving(T_camera_world, affine, exposure)
        newest = window.add(index, pyramid.levels[0], T_camera_world, affine, exposure)
        slots = {keyframe.slot for keyframe in leaving}
        self._activator.activate(window, slots)
        few = _MORE_ITERATIONS.get(len(window.keyframes), 1.0)
        adjusted = adjust(window, options, int(options.iterations * few))
        newest.relinearize()
        self._remove_unseen()
        self._marginalize(leaving)
        self._choose(newest, pyramid)
        return adjusted, leaving

    def points_in(self, keyframe: KeyframeState) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points as a keyframe sees them: pixels float32 N×2, inverse depths, weights, float32 N each."""
        window = self.window
        points = window.points
        own, seen = points.host == keyframe.slot, points.state[:, keyframe.slot] == GOOD
        host, pixel, inverse_depth = points.host[seen], points.pixel[seen], points.inverse_depth[seen]
        projection = window.projection_to(keyframe.T_camera_world, keyframe.affine, keyframe.exposure)
        rays = np.concatenate([pixel, np.ones((len(pixel), 1), np.float32)], axis=1)
        p = np.einsum("nij,nj->ni", projection.KRKi[host], rays)
        p += inverse_depth[:, None] * projection.Kt[host]
        pixels = np.concatenate([points.pixel[own], p[:, :2] / p[:, 2:]])
        depths = np.concatenate([points.inverse_depth[own], inverse_depth / p[:, 2]])
        return pixels, depths, np.sqrt(np.concatenate([points.information[own], points.information[seen]]))

    def _remove_unseen(self) -> None:
        """Points without a good residual are of no use."""
        points = self.window.points
        self.window.points = points.select((points.state == GOOD).any(axis=1))

    def _leaving(self, T_camera_world, affine, exposure: float) -> list[KeyframeState]:
        """Keyframes to marginalize when one with this pose is added (DSO, section 3.1, step 3)."""
        window, options = self.window, self._options
        older = window.keyframes[: 1 - _KEPT_NEWEST]
        projection = window.projection_to(T_camera_world, affine, exposure)
        leaving = []
        for keyframe in older:
            if len(window.keyframes) - len(leaving) < options.keyframes - 2:
                break
            faded = abs(affine[0] + np.log(exposure / keyframe.exposure) - keyframe.affine[0]) > _MAX_BRIGHTNESS_CHANGE
            if faded or self._share_in_use(keyframe, projection) < _MIN_SHARE:
                leaving.append(keyframe)
        if len(window.keyframes) + 1 - len(leaving) > options.keyframes:
            rest = [keyframe for keyframe in older if keyframe not in leaving]
            leaving.append(_farthest(rest, window.keyframes, T_camera_world))
        return leaving

    def _share_in_use(self, keyframe: KeyframeState, projection: Projection) -> float:
        """Of a keyframe's points, those in view of the frame that is projected into, and those that wait."""
        window = self.window
        points, immature = window.points, window.immature
        own = points.host == keyframe.slot
        _, _, inside = project(
            points.pixel[own], points.inverse_depth[own], points.host[own], projection, window.camera.shape
        )
        waiting = np.count_nonzero((immature.host == keyframe.slot) & (immature.status != GONE))
        return (np.count_nonzero(inside) + waiting) / max(keyframe.chosen, 1)

    def _marginalize(self, leaving: list[KeyframeState]) -> None:
        """Points of the leaving keyframes, and points that the newest does not see, become prior or are dropped."""
        window = self.window
        points = window.points
        seen = points.state == GOOD
        going = np.isin(points.host, [keyframe.slot for keyframe in leaving])
        latest = [keyframe.slot for keyframe in window.keyframes[-_KEPT_NEWEST:]]
        going |= ~seen[:, latest].any(axis=1)
        worth = going & (points.information > _MIN_INFORMATION) & (points.good >= _MIN_GOOD)
        marginal = points.select(worth)
        self._on_points_gone(marginal)
        window.points = points.select(~going)
        marginalize_points(window, marginal, self._options)
        for keyframe in leaving:
            marginalize_keyframe(window, keyframe, self._options)

    def _choose(self, keyframe: KeyframeState, pyramid: Pyramid, taken: np.ndarray | None = None) -> None:
        pixels = self._selector.select(pyramid, self._options.candidates)
        if taken is not None:
            known = np.zeros(pyramid.shape, bool)
            known[taken[:, 1], taken[:, 0]] = True
            pixels = pixels[~known[pixels[:, 1], pixels[:, 0]]]
        keyframe.chosen += len(pixels)
        new = new_immature(pyramid.levels[0], pixels, keyframe.slot, self._options.gradient_constant)
        self.window.immature = self.window.immature.joined(new)


def _farthest(rest: list[KeyframeState], keyframes: list[KeyframeState], T_camera_world: np.ndarray) -> KeyframeState:
    """The keyframe to marginalize by DSO's distance score (equation 20): far from the newest, close to the others."""
    centre = {k.index: k.T_world_camera[:3, 3] for k in keyframes}
    newest = -T_camera_world[:3, :3].T @ T_camera_world[:3, 3]

    def score(keyframe: KeyframeState) -> float:
        own = centre[keyframe.index]
        others = [k for k in keyframes[:-1] if k is not keyframe]
        closeness = sum(1.0 / (np.linalg.norm(own - centre[k.index]) + _LEAST_DISTANCE) for k in others)
        return float(np.sqrt(np.linalg.norm(own - newest)) * closeness)

    return max(rest, key=score)


def _thinned(count: int, wanted: int) -> np.ndarray:
    """Every so-manieth of `count` rows, so that `wanted` remain."""
    if count <= wanted:
        return np.arange(count)
    return np.linspace(0, count - 1, wanted).astype(int)
