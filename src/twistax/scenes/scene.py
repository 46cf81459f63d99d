"""A physical case with a known solution, and the error of a state; rotations and poses in NumPy."""

from __future__ import annotations

import dataclasses
import functools
import json
import tomllib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import twistax as tx

from ..checks import number

Array = NDArray[Any]
State = Mapping[str, Any]

_TEXTS: dict[str, dict[str, str]] = tomllib.loads(Path(__file__).with_name("scenes.toml").read_text())
_ENDS: dict[str, dict[str, Any]] = json.loads(Path(__file__).with_name("ends.json").read_text())


@dataclasses.dataclass(frozen=True, eq=False)
class Scene:
    """A system, an initial state, and the exact state at the end. Units are SI and rad.

    Nothing is built before it is needed: `system`, `dynamics` and `end` are found once, when first read.

    Attributes:
        name: a word for the command line, such as "euler-top".
        title: a few words.
        summary: one sentence: the body, its units, and what is hard about it.
        source: where the equations or the answer come from.
        build: makes the system.
        start: the state at t = 0, by name, in double precision.
        duration: from the start to the end, s.
        reference: the state at the end from an independently converged computation; None where `exact` is given.
        exact: the true state at a time in s; None where there is no closed form.
        invariants: outputs of the system that stay constant.
        params: values of the system's parameters.
        u: the controls, as `tx.integrate` takes them.

    Raises:
        InputError: the duration is not positive, or both an exact solution and a reference are given.
    """

    name: str
    title: str
    summary: str
    source: str
    build: Callable[[], tx.System]
    start: State
    duration: float
    reference: State | None = None
    exact: Callable[[float], dict[str, Any]] | None = None
    invariants: tuple[str, ...] = ()
    params: State = dataclasses.field(default_factory=dict)
    u: Any = None

    def __post_init__(self) -> None:
        for field in ("start", "reference", "params"):
            object.__setattr__(self, field, _frozen(getattr(self, field)))
        number(f"scene {self.name!r}: duration", self.duration, "a positive number of s", lambda t: 0.0 < t < np.inf)
        if self.exact is not None and self.reference is not None:
            raise tx.InputError(
                f"scene {self.name!r} has an exact solution and a reference.\n"
                "  fix: leave out reference; the end is exact(duration)"
            )

    @functools.cached_property
    def system(self) -> tx.System:
        """The system."""
        return self.build()

    @functools.cached_property
    def dynamics(self) -> tx.Dynamics:
        """The compiled system."""
        return tx.compile(self.system)

    @functools.cached_property
    def end(self) -> dict[str, Any]:
        """The true state at `duration`. Raises InputError for a scene without a known answer."""
        return self.truth(self.duration)

    def truth(self, t: float) -> dict[str, Any]:
        """The true state at t in s: at any time where there is an exact solution, else at the start and the end.

        Raises:
            InputError: the truth is not known there.
        """
        if self.exact is not None:
            return self.exact(t)
        if self.reference is not None and t == self.duration:
            return dict(self.reference)
        if t == 0.0:
            return dict(self.start)
        known = "no truth is known" if self.reference is None else f"the truth is known at 0 and {self.duration:g} s"
        raise tx.InputError(f"scene {self.name!r} at t = {t!r} s: there is no exact solution, {known}")

    def integrate(self, **options: Any) -> tx.Solution:
        """`tx.integrate` from the start to the end; options are its others: dt, method, save_at and so on."""
        settings = {"t1": self.duration, "u": self.u, "params": self.params, **options}
        return tx.integrate(self.dynamics, self.start, **settings)

    def error(self, x: State, t: float | None = None) -> float:
        """The error of a state as one number: the largest of its parts.

        A rotation counts with the angle to the true one in rad, or, where it has left the group, with its distance
        from it if that is more. Any other part counts with its Euclidean distance over max(1, size of the truth):
        a position, the linear and the angular half of a body twist, any other state as a whole.
        NaN gives NaN.

        Args:
            x: a state by name, without a leading axis.
            t: when, s; the end if left out.
        Raises:
            InputError: a state is missing or of another shape than the truth, or the truth is not known at t.
        """
        truth = self.end if t is None else self.truth(t)
        poses = [state.name for state in self.system.states if state.group == tx.SE3]
        twists = {rate.name for rate in map(self.system.rates.get, poses) if isinstance(rate, tx.State)}
        parts: list[float] = []
        for state in self.system.states:
            if state.name not in x:
                names = ", ".join(x) or "none"
                raise tx.InputError(f"scene {self.name!r}: state {state.name!r} is missing; the states are: {names}")
            wanted, value = np.asarray(truth[state.name], float), np.asarray(x[state.name], float)
            if value.shape != wanted.shape:
                raise tx.InputError(
                    f"scene {self.name!r}: state {state.name!r} expects shape {wanted.shape}, got {value.shape}.\n"
                    "  fix: pass one state; the final state of a solution is {name: value[-1] for name, "
                    "value in sol.xs.items()}"
                )
            with np.errstate(invalid="ignore", over="ignore"):
                if state.group == tx.SO3:
                    parts.append(rotation_angle(wanted, value))
                elif state.group == tx.SE3:
                    parts.append(rotation_angle(wanted[:3, :3], value[:3, :3]))
                    parts.append(_distance(wanted[:3, 3], value[:3, 3]))
                elif state.name in twists:
                    parts += [_distance(wanted[:3], value[:3]), _distance(wanted[3:], value[3:])]
                else:
                    parts.append(_distance(wanted, value))
        return float(np.max(parts))


def said(name: str, **parameters: Any) -> dict[str, Any]:
    """Name, title, summary and source of a scene of this package, from `scenes.toml`, with parameters inserted."""
    texts = {kind: " ".join(text.split()).format(**parameters) for kind, text in _TEXTS[name].items()}
    return {"name": name, **texts}


def stored_end(name: str, **values: float) -> State | None:
    """The end of a scene, for values of its parameters, if known: from `tests/scenes/scene_references.py`."""
    return _ENDS.get(", ".join([name, *(f"{parameter} = {float(value)!r}" for parameter, value in values.items())]))


def _frozen(values: State | None) -> State | None:
    """The same values as read-only arrays: a scene is shared by everyone who looks it up. A dict, which is a pytree."""
    if values is None:
        return None
    arrays = {name: np.array(value, float) for name, value in values.items()}
    for array in arrays.values():
        array.setflags(write=False)
    return arrays


def newton_euler(M: Any, V: tx.Expr, wrench: tx.Expr) -> tx.Expr:
    """The acceleration V' (6,) of a body with the diagonal inertia M (6,) about its centre of mass: M V' = wrench -
    ad*_V(M V).

    ad*_V(M V) holds the moment v x m v. It is zero, but its round-off is not, at 500 m/s beside a small inertia. The
    twist [0; w] in the place of V gives the same without it.
    """
    spin = tx.lie.twist(linear=np.zeros(3), angular=tx.lie.angular(V))
    return (wrench - tx.lie.AdjointDual(spin, M * V)) / M


def total_momentum(poses: Sequence[tx.Expr], momenta: Sequence[Any]) -> dict[str, tx.Expr]:
    """The outputs linear_momentum and angular_momentum (3,) about the world's origin, of the body momenta of bodies."""
    parts = [tx.lie.SE3AdjointDual(g) @ momentum for g, momentum in zip(poses, momenta)]
    total = functools.reduce(tx.Add, parts)
    return {"linear_momentum": tx.lie.linear(total), "angular_momentum": tx.lie.angular(total)}


def rotation_angle(truth: Array, R: Array) -> float:
    """The larger of the angle between two rotations (3, 3), rad, and |R - truth|_F / sqrt(2).

    The angle is the atan2 of its sine, from the skew part of truth^T R, and of its cosine, from the trace: exact to
    round-off for any angle. For two rotations the second distance is 2 sin(angle / 2) and never larger than the angle;
    it is larger only where `R` is no rotation.
    """
    between = truth.T @ R
    skew = 0.5 * (between - between.T)
    sine = np.linalg.norm([skew[2, 1], skew[0, 2], skew[1, 0]])
    cosine = 0.5 * (np.trace(between) - 1.0)
    return float(np.maximum(np.arctan2(sine, cosine), np.linalg.norm(R - truth) / np.sqrt(2.0)))


def _distance(truth: Array, value: Array) -> float:
    """|value - truth| / max(1, |truth|)."""
    return float(np.linalg.norm(value - truth) / max(1.0, float(np.linalg.norm(truth))))


# ---- rotations and poses as NumPy arrays, in the precision of what they are made of --------------------------------


def cross_matrix(a: Array) -> Array:
    """The matrix (3, 3) of the cross product with a (3,)."""
    x, y, z = a
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]], dtype=a.dtype)


def about(axis: Any, angle: Any) -> Array:
    """The rotation (3, 3) about a unit axis (3,) by an angle in rad, by Rodrigues' formula."""
    hat = cross_matrix(np.asarray(axis, np.result_type(np.asarray(axis).dtype, float)))
    return np.eye(3, dtype=hat.dtype) + np.sin(angle) * hat + (1 - np.cos(angle)) * (hat @ hat)


def placed(rotation: Array, position: Any) -> Array:
    """The pose [R p; 0 1] (4, 4)."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, position
    return pose
