"""The page: a map in three dimensions, the pictures of a keyframe, and how a live run keeps up."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import redirect_stdout
from io import StringIO
from queue import Empty, SimpleQueue
from typing import Any

import numpy as np
from matplotlib import colormaps

from polarmap.data.map import Map
from polarmap.data.mesh import Mesh
from polarmap.errors import InputError
from polarmap.geometry.pose import to_quaternion
from polarmap.geometry.sim3 import Sim3
from polarmap.report import pictures
from polarmap.report.keyframe_pictures import PICTURES
from polarmap.viewer.patch import COLOURS, SHOWN, Patch
from polarmap.viewer.watcher import Tracking

_MOST_PATCHES = 200  # pieces of surface on the page; of more, every second one goes
_MOST_WAY = 20_000  # positions of the line that the camera has gone; of more, every second one goes
_PIECE = 500  # steps of that line, which are sent together
_CAMERA = (230, 120, 30)
_WAY = (40, 90, 200)
_BEHIND, _ABOVE = 0.5, 0.2  # the camera, where the page begins to look from, in depths of what it sees
_FRUSTUM = 0.04  # of the depth that the first keyframe sees


class Page:
    """A page at http://HOST:PORT, or the next free port; a `polarmap.viewer.feed.Display`.

    title: in the browser's tab. Raises InputError where viser, which the extra `view` brings, is missing, or the
    address cannot be had.
    """

    def __init__(self, host: str = "127.0.0.1", port: int = 8080, title: str = "polarmap") -> None:
        viser = _viser()
        try:
            with redirect_stdout(StringIO()):  # it prints a banner
                self._server = viser.ViserServer(host=host, port=port, label=title, verbose=False)
        except (OSError, RuntimeError) as problem:
            raise InputError(
                f"the page cannot be at {host}:{port} ({problem}); choose another with --view-at"
            ) from None
        self.address = f"http://{host}:{self._server.get_port()}"
        self._asked: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self._patches: dict[int, Patch] = {}  # by index, in order of time
        self._nodes: dict[int, Any] = {}
        self._way: list[np.ndarray] = []
        self._lines: list[Any] = []  # pieces of the way, each begins where the one before ends
        self._segment = 0
        self._origin: np.ndarray | None = None
        self._size: float | None = None
        self._colour = COLOURS[0]
        self._mesh: Any = None
        self._make_panel()

    def close(self) -> None:
        """End the page."""
        with redirect_stdout(StringIO()):
            self._server.stop()

    def say(self, text: str) -> None:
        """Show a line of markdown at the top of the panel."""
        self._state.content = text

    def refresh(self) -> None:
        """Do what those who look have asked for since the last call."""
        while True:
            try:
                self._asked.get_nowait()()
            except Empty:
                return

    def track(self, tracking: Tracking, positions: list[np.ndarray]) -> None:
        """Show where the camera is and has been, and how the run keeps up."""
        if tracking.segment != self._segment:
            self._begin(tracking.segment)
        self._state.content = _state(tracking)
        self._lengthen([self._local(position) for position in positions])
        if tracking.T_world_camera is not None and self._camera is not None:
            self._camera.wxyz, self._camera.position = self._placed(Sim3.from_matrix(tracking.T_world_camera))

    def add(self, patch: Patch) -> None:
        """Show a keyframe's piece of surface; the panel then has its pictures, unless another was picked."""
        if patch.segment != self._segment:
            self._begin(patch.segment)
        follows = not self._patches or self._picked.value == max(self._patches)
        self._patches[patch.index] = patch
        if self._size is None and len(patch.vertices):
            self._size = float(np.median(patch.vertices[:, 2]))
            self._look_over(patch.pose)
        self._draw(patch)
        self._thin_out()
        self._offer(follows)

    def move(self, index: int, pose: Sim3) -> None:
        """Move a keyframe's piece of surface."""
        patch = self._patches.get(index)
        if patch is not None:
            self._patches[index] = moved = patch.moved(pose)
            self._place(moved)

    def show_map(self, result: Map) -> None:
        """Show the fused surface in place of the keyframes' pieces."""
        if result.mesh is not None and result.segment == self._segment:
            self.show_mesh(result.mesh, result.origin)

    def show_mesh(self, mesh: Mesh, origin: np.ndarray) -> None:
        """Show a fused surface whose vertices are counted from `origin`, in place of the keyframes' pieces."""
        colours = pictures.grey(mesh.grey[None], max(float(np.percentile(mesh.grey, 99)), 1e-3))[0]
        self._mesh = self._server.scene.add_mesh_trimesh("/map", _trimesh(mesh.vertices, mesh.faces, colours))
        self._mesh.position = self._local(origin)
        self._whole.disabled, self._whole.value = False, True
        self._choose_surface()

    # The panel

    def _make_panel(self) -> None:
        gui = self._server.gui
        self._state = gui.add_markdown("Waiting for the first frame.")
        self._kind = gui.add_dropdown("colour", COLOURS, hint="of the keyframes' pieces of surface")
        self._kind.on_update(lambda _: self._asked.put(self._recolour))
        self._whole = gui.add_checkbox("fused surface", False, disabled=True, hint="or the keyframes' pieces")
        self._whole.on_update(lambda _: self._asked.put(self._choose_surface))
        self._picked = gui.add_slider("keyframe", 0, 1, 1, 0, disabled=True, hint="whose pictures are below")
        self._picked.on_update(lambda _: self._asked.put(self._show_pictures))
        self._go = gui.add_button("look from there", disabled=True)
        self._go.on_click(lambda event: self._asked.put(lambda: self._look_from(event.client)))
        self._name = gui.add_markdown("")
        blank = np.full((3, 4, 3), pictures.MISSING, np.uint8)
        self._pictures = {name: gui.add_image(blank, label=PICTURES[name][0], visible=False) for name in SHOWN}
        self._camera: Any = None

    def _offer(self, follow: bool) -> None:
        """Let one pick among the keyframes that there are. follow: pick the newest."""
        first, last = min(self._patches), max(self._patches)
        self._picked.min, self._picked.max = first, max(last, first + 1)
        self._picked.disabled = self._go.disabled = False
        if follow:
            self._picked.value = last
            self._show_pictures()

    def _chosen(self) -> Patch | None:
        """The keyframe nearest to the one that was picked."""
        picked = self._picked.value
        return min(self._patches.values(), key=lambda patch: abs(patch.index - picked), default=None)

    def _show_pictures(self) -> None:
        patch = self._chosen()
        if patch is None:
            return
        self._name.content = f"frame {patch.index}"
        for name, handle in self._pictures.items():
            if name in patch.pictures:
                handle.image = patch.pictures[name]
            handle.visible = name in patch.pictures

    def _look_from(self, client: Any) -> None:
        patch = self._chosen()
        if patch is not None and client is not None:
            client.camera.wxyz, client.camera.position = self._placed(patch.pose)

    def _look_over(self, pose: Sim3) -> None:
        """Let the page begin with a look over the first camera's shoulder, whose up is up."""
        _, down, forward = pose.rotation.T
        eye = self._local(pose.translation) - self._size * (_BEHIND * forward + _ABOVE * down)
        self._server.scene.set_up_direction(-down)
        camera = self._server.initial_camera
        camera.position, camera.up, camera.look_at = eye, -down, self._local(pose.translation) + self._size * forward

    def _choose_surface(self) -> None:
        whole = bool(self._whole.value) and self._mesh is not None
        if self._mesh is not None:
            self._mesh.visible = whole
        for node in self._nodes.values():
            node.visible = not whole

    def _recolour(self) -> None:
        self._colour = self._kind.value
        if self._mesh is not None and self._whole.value:
            self._whole.value = False  # colours are the pieces'
        for patch in self._patches.values():
            self._draw(patch)
        self._choose_surface()

    # The scene

    def _begin(self, segment: int) -> None:
        """Another world: nothing of the one before is shown any more."""
        self._segment, self._way, self._size, self._origin = segment, [], None, None
        for line in self._lines:
            line.remove()
        self._lines.clear()
        for node in self._nodes.values():
            node.remove()
        self._nodes.clear()
        self._patches.clear()

    def _lengthen(self, positions: list[np.ndarray]) -> None:
        """Draw the way on; only the pieces that change are sent again."""
        unchanged = max(len(self._way) - 1, 0) // _PIECE
        self._way += positions
        if len(self._way) > _MOST_WAY:
            self._way, unchanged = self._way[::2], 0
        ends = np.array(self._way, np.float32)
        pieces = max(0, -(-(len(ends) - 1) // _PIECE))
        for piece in range(unchanged, pieces):
            part = ends[piece * _PIECE : (piece + 1) * _PIECE + 1]
            line = self._server.scene.add_line_segments(
                f"/way/{piece}", np.stack([part[:-1], part[1:]], axis=1), colors=_WAY, thickness=2.0,
                thickness_units="screen",
            )  # fmt: skip
            self._lines[piece : piece + 1] = [line]
        for line in self._lines[pieces:]:
            line.remove()
        del self._lines[pieces:]

    def _draw(self, patch: Patch) -> None:
        if not len(patch.faces):
            return
        name, colours = f"/keyframes/{patch.index}", self._colours(patch)
        visible = not (self._mesh is not None and self._whole.value)
        mesh = _trimesh(patch.vertices, patch.faces, colours)
        self._nodes[patch.index] = self._server.scene.add_mesh_trimesh(name, mesh, visible=visible)
        self._place(patch)
        if self._camera is None and self._size is not None:
            camera = patch.camera
            self._camera = self._server.scene.add_camera_frustum(
                "/camera", 2 * np.arctan(camera.height / (2 * camera.fy)), camera.width / camera.height,
                scale=_FRUSTUM * self._size, color=_CAMERA,
            )  # fmt: skip
            self._camera.wxyz, self._camera.position = self._placed(patch.pose)

    def _colours(self, patch: Patch) -> np.ndarray:
        if self._colour != "age":
            return patch.colours[self._colour]
        order = sorted(self._patches)
        share = order.index(patch.index) / max(len(order) - 1, 1)
        colour = np.round(255 * np.array(colormaps["viridis"](share)[:3])).astype(np.uint8)
        return np.broadcast_to(colour, patch.vertices.shape)

    def _place(self, patch: Patch) -> None:
        node = self._nodes.get(patch.index)
        if node is not None:
            node.wxyz, node.position = self._placed(patch.pose)
            node.scale = float(patch.pose.scale)

    def _thin_out(self) -> None:
        """Keep what the browser has to hold within bounds: older keyframes become fewer, the newest stays."""
        if len(self._patches) <= _MOST_PATCHES:
            return
        for index in sorted(self._patches)[1:-1:2]:
            del self._patches[index]
            if (node := self._nodes.pop(index, None)) is not None:
                node.remove()

    def _placed(self, pose: Sim3) -> tuple[np.ndarray, np.ndarray]:
        """Orientation (w, x, y, z) and position on the page."""
        _, (x, y, z, w) = to_quaternion(pose.rigid)
        return np.array([w, x, y, z]), self._local(pose.translation)

    def _local(self, position: np.ndarray) -> np.ndarray:
        """Counted from the first position, since the browser has single precision."""
        if self._origin is None:
            self._origin = np.array(position, np.float64)
        return position - self._origin


def _state(tracking: Tracking) -> str:
    lines = [f"**{tracking.keyframes} keyframes**" + ("" if tracking.T_world_camera is not None else ", no pose")]
    if tracking.late is not None:
        lines.append(f"pose after {tracking.late:.0f} ms, {tracking.waiting} keyframes wait")
        lines.append(f"{tracking.skipped} keyframes skipped, {tracking.missed} frames missed")
    return "  \n".join(lines)


def _trimesh(vertices: np.ndarray, faces: np.ndarray, colours: np.ndarray) -> Any:
    import trimesh

    return trimesh.Trimesh(vertices, faces, vertex_colors=colours, process=False)


def _viser() -> Any:
    try:
        import viser
    except ImportError:
        raise InputError('the view in the browser needs viser: pip install "polarmap[view]"') from None
    return viser
