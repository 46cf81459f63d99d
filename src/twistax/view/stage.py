"""Drawing of a scene by viser (extra `view`): as one self-contained HTML page, or served to a browser."""

from __future__ import annotations

import contextlib
import io
import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy import ndarray as Array

from ..errors import ModelError
from .animation import RATE, Animation, Body
from .shapes import Capsule, Ellipsoid, Shape, Sphere

#: The scene is drawn this large, whatever its size: GPUs have single precision, cameras a nearest distance.
_DRAWN = 10.0
_TRAIL = (31, 95, 153)
_GROUND, _CELLS, _SECTIONS = (238, 240, 243), (214, 218, 224), (184, 190, 200)
_CAMERA = np.array([0.4, -0.78, 0.33])
#: Where the ground begins to fade into the background and where it is gone, and the size of the caption on the screen.
_FADE, _CAPTION = (2.5 * _DRAWN, 9.0 * _DRAWN), 1.6


def page(scene: Animation) -> str:
    """The animation as one HTML page."""
    with silent_server() as server:
        frames = scene.frames()
        stage = Stage(server, frames)
        recorded = server.get_scene_serializer()
        for k in range(1, len(frames.ts)):
            recorded.insert_sleep(frames.duration / (len(frames.ts) - 1))
            stage.draw(k)
        return str(recorded.as_html())


def served(scene: Animation, port: int) -> Any:
    """A server of the scene, with a slider; the animation runs in a separate thread until the server stops."""
    server = _viser().ViserServer(host="127.0.0.1", port=port)
    frames = scene.frames()
    stage, last = Stage(server, frames), len(frames.ts) - 1
    playing = server.gui.add_checkbox("play", True)
    slider = server.gui.add_slider("picture", 0, last, 1, 0)
    slider.on_update(lambda _: stage.draw(int(slider.value)))

    stopped, stop, turn = threading.Event(), server.stop, threading.Lock()

    def stop_both() -> None:
        with turn:
            stopped.set()
        stop()

    def play() -> None:
        while not stopped.wait(1.0 / RATE):
            with turn:
                if playing.value and not stopped.is_set():
                    slider.value = (int(slider.value) + 1) % (last + 1)

    server.stop = stop_both
    threading.Thread(target=play, daemon=True).start()
    return server


def _viser() -> Any:
    try:
        import viser
    except ImportError as error:
        raise ModelError(f"show needs viser ({error}).\n  fix: pip install 'twistax[view]'") from None
    return viser


@contextlib.contextmanager
def silent_server() -> Iterator[Any]:
    """A server without clients: viser records the messages that it would send. Its start message is suppressed."""
    viser = _viser()
    with contextlib.redirect_stdout(io.StringIO()):
        server = viser.ViserServer(host="127.0.0.1", verbose=False)
        try:
            yield server
        finally:
            server.stop()


class Stage:
    """The nodes of a scene on a server, and their poses in frame k."""

    def __init__(self, server: Any, scene: Animation) -> None:
        low, high = scene.extent()
        self.scene, self.nodes = scene, server.scene
        self.center, self.zoom = 0.5 * (low + high), _DRAWN / scene.view_size
        self.turn = _upwards(np.asarray(scene.up))
        server.scene.set_up_direction(tuple(self.turn[:, 2]))
        server.scene.configure_fog(*_FADE)
        server.initial_camera.up = tuple(self.turn[:, 2])
        server.initial_camera.look_at = (0.0, 0.0, 0.0)
        server.initial_camera.position = tuple(self.turn @ (_DRAWN * _CAMERA))
        # All that has a place in the world is below one frame, which goes back as the followed body goes on.
        self.world = self.nodes.add_frame("/world", show_axes=False)
        square = self._grid(low, high)
        self.note = f"   squares of {square:g} m" if scene.ground else ""
        self.bodies = [self._body(body) for body in scene.bodies]
        for i, shape in enumerate(scene.shapes):
            self._solid(f"/world/shapes/{i}", shape, self.center)
        self.arrows = [self._arrow(f"/world/arrows/{vector.name}", vector.color) for vector in scene.vectors]
        self.ends = [self._drawn(vector.ends(scene.scale_of(vector))) for vector in scene.vectors]
        self.label = self.nodes.add_label(
            "/time",
            "",
            position=tuple(self.turn @ [0.0, 0.0, 0.45 * _DRAWN]),
            font_screen_scale=_CAPTION,
            anchor="bottom-center",
        )
        self.digits = max(0, int(np.ceil(-np.log10((scene.ts[-1] - scene.ts[0]) / len(scene.ts)))))
        followed = scene.followed
        self.middles = None if followed is None else self._drawn(followed.poses[:, :3, 3])
        self.draw(0)

    def draw(self, k: int) -> None:
        """Move all objects to frame k."""
        if self.middles is not None:
            self.world.position = -self.middles[k]
        for node, places, turns in self.bodies:
            node.position, node.wxyz = places[k], turns[k]
        for arrow, ends in zip(self.arrows, self.ends):
            arrow.visible = bool(np.linalg.norm(ends[k, 1] - ends[k, 0]) > 0.01)
            arrow.points = ends[k][None].astype(np.float32)
        values = [f"{name} = {_listed(of[k], _decimals(of))}" for name, of in self.scene.caption.items()]
        self.label.text = "   ".join([f"t = {self.scene.ts[k]:.{self.digits}f} s", *values]) + self.note

    def _drawn(self, points: Array) -> Array:
        return (points - self.center) * self.zoom

    def _body(self, body: Body) -> tuple[Any, Array, Array]:
        name, places = f"/world/bodies/{body.name.replace('/', ' ')}", self._drawn(body.poses[:, :3, 3])
        node = self.nodes.add_frame(name, show_axes=body.axes, axes_length=0.6, axes_radius=0.02)
        for i, shape in enumerate(body.shapes):
            self._solid(f"{name}/{i}", shape, np.zeros(3))
        if body.trail:
            lines = np.stack([places[:-1], places[1:]], axis=1).astype(np.float32)
            self.nodes.add_line_segments(f"/world/trails{name}", lines, _TRAIL, thickness=2.0, thickness_units="screen")
        return node, places, quaternions(body.poses[:, :3, :3])

    def _solid(self, name: str, shape: Shape, origin: Array) -> None:
        corners, faces = shape.mesh()
        self.nodes.add_mesh_simple(
            name,
            (corners * self.zoom).astype(np.float32),
            faces.astype(np.uint32),
            color=shape.color,
            opacity=None if shape.opacity == 1.0 else shape.opacity,
            flat_shading=not isinstance(shape, (Capsule, Ellipsoid, Sphere)),
            side="front" if shape.opacity == 1.0 else "double",
            cast_shadow=shape.opacity == 1.0,
            wxyz=tuple(quaternions(shape.at[None, :3, :3])[0]),
            position=tuple((shape.at[:3, 3] - origin) * self.zoom),
        )

    def _arrow(self, name: str, color: Any) -> Any:
        start = np.zeros((1, 2, 3), np.float32)
        return self.nodes.add_arrows(name, start, color, shaft_radius=0.03, head_radius=0.08, head_length=0.2)

    def _grid(self, low: Array, high: Array) -> float:
        """A grid below all, or on the world's zero where that is near; the side of its squares, m."""
        corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
        least = (corners @ self.turn[:, 2]).min()
        height = 0.0 if abs(least) < 0.15 * self.scene.size else least
        rough = self.scene.view_size / 8.0
        power = 10.0 ** np.floor(np.log10(rough))
        square = float(power * max(n for n in (1.0, 2.0, 5.0) if n * power <= rough))
        # Its lines lie on whole numbers of squares.
        place = np.round(self.center @ self.turn / square) * square
        place[2] = height
        width = 2.0 * _FADE[1] + 2.0 * self.zoom * self.scene.size
        self.nodes.add_grid(
            "/world/ground",
            width,
            width,
            visible=self.scene.ground,
            plane_color=_GROUND,
            plane_opacity=1.0,
            shadow_opacity=0.4,
            cell_color=_CELLS,
            section_color=_SECTIONS,
            cell_size=square * self.zoom,
            section_size=5.0 * square * self.zoom,
            wxyz=tuple(quaternions(self.turn[None])[0]),
            position=tuple(self._drawn(self.turn @ place)),
        )
        return square


def _decimals(values: Array) -> int | None:
    """Decimals that show three digits of the largest value, so that a text keeps its length; None without one."""
    largest = float(np.max(np.abs(values), initial=0.0))
    return max(0, 2 - int(np.floor(np.log10(largest)))) if 1e-6 < largest < 1e9 else None


def _listed(value: Any, decimals: int | None) -> str:
    """A number, or the entries of a small array."""
    entries = [float(entry) for entry in np.ravel(value)[:6]]
    if decimals is None:
        return ", ".join(f"{entry:.3g}" for entry in entries)
    return ", ".join(f"{round(entry, decimals) + 0.0:,.{decimals}f}" for entry in entries)


def quaternions(R: Array) -> Array:
    """Rotations (n, 3, 3) as quaternions [w, x, y, z] (n, 4)."""
    from scipy.spatial.transform import Rotation

    return np.roll(Rotation.from_matrix(R).as_quat(), 1, axis=1)


def _upwards(up: Array) -> Array:
    """A rotation from z to a direction; None for z itself."""
    z = up / np.linalg.norm(up)
    x = np.cross((0.0, 1.0, 0.0) if abs(z[1]) < 0.9 else (0.0, 0.0, 1.0), z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)
