"""A million steps."""

from __future__ import annotations

import functools
from typing import Any

import jax.numpy as jnp
import numpy as np

import twistax as tx

from ...scenes import SCENES, heavy_top
from .. import drift
from .row import AtMost, Expected, Place, Row, Section, flown, plain

__all__ = ["LONG_RUNS"]

_FEW, _MANY = (1_000, 10_000), (100_000, 1_000_000)
_TOP = SCENES["long-heavy-top"]
_SPLITTING = tx.Splitting(tx.compositions.KAHAN_LI8, tx.FreeBody("R", "w", inertia=heavy_top.INERTIA))


@functools.cache
def _drifts(counts: tuple[int, ...]) -> dict[str, drift.Course]:
    """A free body and a constant twist, their rotations stored as quaternions, by what moves."""
    return {course.motion: course for course in drift.courses(counts) if course.stored == "quaternion"}


@functools.cache
def _top(method: Any, dt: float, counts: tuple[int, ...]) -> dict[str, Any]:
    """The largest changes of the heavy top's invariants, and |R'R - I|, after so many steps."""
    times = np.array([0, *counts]) * dt
    sol = flown(_TOP.dynamics, dict(_TOP.start), t1=float(times[-1]), dt=dt, method=method, save_at=times)
    kept = [
        _TOP.dynamics.outputs(jnp.asarray(0.0), {name: value[i] for name, value in sol.xs.items()})
        for i in range(len(times))
    ]
    found: dict[str, Any] = {
        name: [abs(float(each[name]) - float(kept[0][name])) for each in kept[1:]] for name in _TOP.invariants
    }
    R = np.asarray(sol.xs["R"])[1:]
    found["defect"] = np.abs(np.swapaxes(R, 1, 2) @ R - np.eye(3)).max(axis=(1, 2))
    return found


def _rows(what: str, method: str, of: Any, bars: tuple[Expected, Expected], why: str, slow: bool = False) -> list[Row]:
    """After each number of steps; of(counts, i) gives the number. The bars are for up to 1e4 and up to 1e6 steps."""
    rows = []
    for counts, bar in zip((_FEW, _MANY), bars, strict=True):
        rows += [
            Row(
                f"{what}, {plain(count)} steps",
                method,
                functools.partial(of, counts, i),
                bar,
                why,
                slow=slow or counts is _MANY,
                place=Place(f"{what}, {method}", float(count)),
            )
            for i, count in enumerate(counts)
        ]
    return rows


def _of_top(method: Any, dt: float, name: str) -> Any:
    return lambda counts, i: _top(method, dt, counts)[name][i]


def _of_drift(motion: str, name: str) -> Any:
    return lambda counts, i: getattr(_drifts(counts)[motion], name)[i]


_RK4, _DOP853 = tx.RKMK(tx.tableaus.RK4), tx.RKMK(tx.tableaus.DOP853)

LONG_RUNS = Section(
    "long",
    "A million steps",
    "A free body with an offset centre of mass in steps of 10 ms, and the heavy top, in steps of 1 ms with RK4 and of "
    "10 ms with the others. Changes since the start: J, N s, N m s.",
    (
        *_rows(
            "R'R - I, constant twist",
            "RK4",
            _of_drift("constant twist", "defect"),
            (AtMost(1e-14), AtMost(1e-14)),
            "A quaternion put back to length one in every step cannot drift, even where every step rounds alike.",
            slow=True,
        ),
        *_rows(
            "energy, free body",
            "RK4",
            _of_drift("free body", "energy"),
            (AtMost(5e-7, "J"), AtMost(5e-5, "J")),
            "A method without structure loses energy in every step: the drift is linear, and that of its order.",
            slow=True,
        ),
        *_rows(
            "linear momentum, free body",
            "RK4",
            _of_drift("free body", "linear"),
            (AtMost(1e-5, "N s"), AtMost(1e-3, "N s")),
            "The same for momentum, which lives in the body's axes here.",
            slow=True,
        ),
        *_rows(
            "energy, heavy top",
            "RK4",
            _of_top(_RK4, 1e-3, "energy"),
            (AtMost(1e-11, "J"), AtMost(1e-9, "J")),
            "Short steps lose little, in every one of them.",
        ),
        *_rows(
            "energy, heavy top",
            "DOP853",
            _of_top(_DOP853, 1e-2, "energy"),
            (AtMost(5e-13, "J"), AtMost(5e-11, "J")),
            "At order eight the drift of a million steps is near round-off.",
        ),
        *_rows(
            "energy, heavy top",
            "Kahan-Li 8 splitting",
            _of_top(_SPLITTING, 1e-2, "energy"),
            (AtMost(2e-11, "J"), AtMost(2e-9, "J")),
            "A symplectic method has no drift of its own; what grows is round-off, some 1e-16 J a step.",
            slow=True,
        ),
        *_rows(
            "vertical momentum, heavy top",
            "Kahan-Li 8 splitting",
            _of_top(_SPLITTING, 1e-2, "vertical_momentum"),
            (AtMost(1e-14, "N m s"), AtMost(1e-14, "N m s")),
            "Momenta are stored in world axes: what no torque changes stays to the last bit or two.",
            slow=True,
        ),
        *_rows(
            "R'R - I, heavy top",
            "Kahan-Li 8 splitting",
            _of_top(_SPLITTING, 1e-2, "defect"),
            (AtMost(1e-14), AtMost(1e-14)),
            "The group is kept as by every method here.",
            slow=True,
        ),
    ),
    axes=("steps", "change since the start"),
)
