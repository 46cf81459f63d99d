"""Scenes from the states of a motion: bodies and arrows."""

from __future__ import annotations

import dataclasses
import tempfile
import webbrowser
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray as Array

from ..checks import listed, number, reals, short
from ..errors import InputError
from ..groups import SE3, SO3
from ..plots import group_of
from ..progress import watching
from .animation import Arrow, Body, Vector
from .scene import Scene
from .shapes import Color, Shape

#: States and what belongs to them: by name, (n, ...) values at the times of a motion.
Values = Mapping[str, Any]


@dataclasses.dataclass(frozen=True, eq=False)
class Motion:
    """The values of a motion.

    Attributes:
        ts: (n,) times in s.
        xs: states by name.
        lookups: functions that return controls and outputs by name; the first one that has a name is used.
        params: the parameters, if they are known.
    """

    ts: Array
    xs: Values
    lookups: Sequence[Callable[[], Values]] = ()
    params: Values = dataclasses.field(default_factory=dict)

    def value(self, name: str) -> Array:
        """The values (n, ...) of a state, control or output. Raises InputError for an unknown name."""
        known: list[str] = []
        for some in (lambda: self.xs, *self.lookups):
            there = some()
            if name in there:
                return np.asarray(there[name], dtype=np.float64)
            known += there
        raise InputError(f"show: there is no {name!r} to draw as an arrow; there are: {listed(known, name)}")


def joined(parts: Sequence[Values]) -> dict[str, Array]:
    """Values of consecutive motions, joined, for the names that all of them have."""
    values = {name: [np.asarray(part[name]) for part in parts if name in part] for name in parts[0]}
    everywhere = [n for n, part in values.items() if len(part) == len(parts) and len({v.shape[1:] for v in part}) == 1]
    return {name: np.concatenate(values[name]) for name in everywhere}


@watching("show")
def shown(
    motion: Motion,
    path: Any = None,
    *,
    bodies: Any = None,
    arrows: Mapping[str, Any] | None = None,
    shapes: Any = (),
    trails: Iterable[str] | None = None,
    axes: Iterable[str] | None = None,
    up: Any = (0.0, 0.0, 1.0),
    seconds: float | None = None,
    follow: str | None = None,
    caption: Iterable[str] = (),
    ground: bool = True,
    live: bool = False,
    opened: bool = True,
) -> Scene:
    """The scene of a motion, written, served or opened; see `Solution.show`."""
    if seconds is not None:
        number("show: seconds", seconds, "a positive time", lambda x: 0.0 < x < np.inf)
    upwards = reals("show: up", up, InputError)
    if upwards.shape != (3,) or not np.isfinite(upwards).all() or not upwards.any():
        raise InputError(f"show expects up to be a direction (3,), got {short(up)}")
    motion = _reached(motion)
    drawn = _drawn(_bodies(motion, bodies), trails, axes)
    vectors = [vector for name, looks in (arrows or {}).items() for vector in _vectors(motion, drawn, name, looks)]
    if follow is not None:
        _named(drawn, follow)
    values = {name: motion.value(name) for name in ((caption,) if isinstance(caption, str) else caption)}
    scene = Scene(
        motion.ts, drawn, tuple(vectors), _shapes("shapes", shapes), upwards, seconds, follow, values, bool(ground)
    )
    if path is not None:
        scene.save(path)
    if live:
        scene.live()
    elif path is None and opened and not _in_notebook():
        webbrowser.open(scene.save(Path(tempfile.mkdtemp(prefix="twistax")) / "scene.html").as_uri())
    return scene


def _in_notebook() -> bool:
    try:
        from IPython import get_ipython
    except ImportError:
        return False
    return get_ipython() is not None


def _reached(motion: Motion) -> Motion:
    """The motion without times that were not reached, each time once. Raises InputError if fewer than two are left."""
    ts = np.asarray(motion.ts, dtype=np.float64)
    good = np.isfinite(ts)
    for value in motion.xs.values():
        good &= np.isfinite(np.asarray(value, dtype=np.float64).reshape(len(ts), -1)).all(axis=1)
    kept = np.flatnonzero(good)
    kept = kept[np.append(np.diff(ts[kept]) > 0.0, True)] if len(kept) else kept
    if len(kept) < 2:
        raise InputError("show expects two saved times or more, got one.\n  fix: tx.integrate(..., save_at=times)")

    def rows(some: Values) -> Values:
        return {name: np.asarray(value)[kept] for name, value in some.items()}

    further = [lambda some=some: rows(some()) for some in motion.lookups]
    return Motion(ts[kept], rows(motion.xs), further, motion.params)


# ---- bodies --------------------------------------------------------------------------------------------------------


def _bodies(motion: Motion, wanted: Any) -> tuple[Body, ...]:
    if hasattr(wanted, "bodies_in_view"):
        return tuple(wanted.bodies_in_view(motion.xs, motion.params))
    if wanted is None:
        wanted = {name: () for name, value in motion.xs.items() if group_of(value) is not None}
        if not wanted:
            raise InputError(
                f"show: no state is a pose or a rotation; there are: {listed(motion.xs)}.\n"
                "  fix: for a mechanism use solution.show(bodies=mechanism)"
            )
    if not isinstance(wanted, Mapping):
        raise InputError(
            "show expects bodies as a mechanism, or as a mapping of states to shapes, such as "
            f'{{"g": tx.view.Box((1.0, 1.0, 2.0))}}, got {short(wanted)}'
        )
    return tuple(_body(motion.xs, key, shapes) for key, shapes in wanted.items())


def _body(xs: Values, key: Any, shapes: Any) -> Body:
    """The body of a pose, of a rotation about the origin, or of a pair of a rotation and a position."""
    names = key if isinstance(key, tuple) else (key,)
    for name in names:
        if name not in xs:
            raise InputError(f"show: there is no state {short(name)}; there are: {listed(xs, name)}")
    value = np.asarray(xs[names[0]], dtype=np.float64)
    group, poses = group_of(value), np.tile(np.eye(4), (len(value), 1, 1))
    if group == SE3 and len(names) == 1:
        poses[:] = value
    elif group == SO3 and len(names) <= 2:
        poses[:, :3, :3] = value
        if len(names) == 2:
            position = np.asarray(xs[names[1]], dtype=np.float64)
            if position.shape[1:] != (3,):
                raise InputError(f"show expects {names[1]!r} to be a position (3,), got shape {position.shape[1:]}")
            poses[:, :3, 3] = position
    else:
        raise InputError(
            f"show expects bodies to be poses, rotations, or pairs of a rotation and a position, got {key!r}, where "
            f"{names[0]!r} has shape {value.shape[1:]}"
        )
    return Body(names[0], poses, _shapes(f"bodies[{key!r}]", shapes), trail=group == SE3 or len(names) == 2)


def _shapes(place: str, shapes: Any) -> tuple[Shape, ...]:
    sequence = (shapes,) if isinstance(shapes, Shape) else tuple(shapes) if isinstance(shapes, Iterable) else (shapes,)
    for shape in sequence:
        if not isinstance(shape, Shape):
            raise InputError(f"show expects {place} as shapes, such as tx.view.Sphere(1.0), got {short(shape)}")
    return sequence


def _drawn(bodies: tuple[Body, ...], trails: Iterable[str] | None, axes: Iterable[str] | None) -> tuple[Body, ...]:
    """The bodies with the trails and axes that are asked for, or with their defaults."""
    with_trail, with_axes = _names(bodies, trails), _names(bodies, axes)
    return tuple(
        dataclasses.replace(
            body,
            trail=body.trail if with_trail is None else body.name in with_trail,
            axes=body.axes if with_axes is None else body.name in with_axes,
        )
        for body in bodies
    )


def _names(bodies: tuple[Body, ...], names: Iterable[str] | None) -> set[str] | None:
    if names is None:
        return None
    return {_named(bodies, name).name for name in ([names] if isinstance(names, str) else names)}


def _named(bodies: tuple[Body, ...], name: Any) -> Body:
    match = next((body for body in bodies if body.name == name), None)
    if match is None:
        raise InputError(f"show: there is no body {short(name)}; there are: {listed([b.name for b in bodies], name)}")
    return match


# ---- arrows --------------------------------------------------------------------------------------------------------


def _vectors(motion: Motion, bodies: tuple[Body, ...], name: str, looks: Any) -> list[Vector]:
    if not isinstance(looks, Arrow):
        raise InputError(f"show expects arrows[{name!r}] to be a tx.view.Arrow, got {short(looks)}")
    if looks.on is None and len(bodies) > 1:
        raise InputError(
            f"show: arrows[{name!r}] may start from any of {listed(b.name for b in bodies)}.\n"
            f"  fix: tx.view.Arrow({bodies[0].name!r})"
        )
    body = bodies[0] if looks.on is None else _named(bodies, looks.on)
    values = motion.value(name)
    if values.shape[1:] not in ((3,), (6,)):
        raise InputError(
            f"show expects arrows of vectors (3,) or of wrenches (6,), {name!r} has shape {values.shape[1:]}"
        )
    values = np.nan_to_num(values)  # of a control that is not known after its last time
    if values.shape[1] == 3:
        return [Vector(name, body, values, looks, looks.color)]
    red, green, blue = looks.color
    darker: Color = (red // 2, green // 2, blue // 2)
    return [
        Vector(f"{name} linear", body, values[:, :3], looks, looks.color),
        Vector(f"{name} angular", body, values[:, 3:], looks, darker),
    ]
