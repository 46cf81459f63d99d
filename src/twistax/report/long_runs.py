"""What splitting methods keep over a million steps, and what they cost on a symmetric top beside diffrax.

`python -m twistax.report.long_runs` prints how far energy and momentum of heavy tops and free bodies have gone, and the
time at an error on the heavy top. Exit status 1 if a bar is missed.
"""

from __future__ import annotations

import dataclasses
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

import twistax as tx

from ..integrators import Method
from ..scenes import SCENES, heavy_top, offset_tumble
from .machine import machine
from .work_precision.contender import Line, Side
from .work_precision.contenders import CONTENDERS
from .work_precision.curve import Curve
from .work_precision.effort import FULL
from .work_precision.flights import empty_call_seconds, measure_scene
from .work_precision.ladder import Ladder, Steps
from .work_precision.origin import origin_of
from .work_precision.own import FixedSteps
from .work_precision.progress import Progress
from .work_precision.row import Row
from .work_precision.store import Store

__all__ = ["BARS", "Kept", "Motion", "flown", "main", "motions", "rivals"]

STEPS = 1_000_000

#: The largest relative changes over a million steps, and the time at an error of 1e-9 over that of the best of diffrax.
BARS = {"energy": 1e-10, "vertical momentum": 1e-9, "momentum": 1e-12, "time": 0.5}

#: At this error times are compared.
ERROR = 1e-9

_DT = 1e-2  # s
_SAVES = 101

Array = NDArray[Any]


@dataclasses.dataclass(frozen=True)
class Motion:
    """A system, its start, and what a true flight keeps.

    Attributes:
        name: for the table.
        bodies: its free motion.
        kept: name -> what stays, a function of states with a leading axis that gives (n,) or (n, k), and its size.
        judged: the composition and what of it has a bar.
    """

    name: str
    dynamics: tx.Dynamics
    start: dict[str, Any]
    bodies: Any
    kept: dict[str, Callable[[dict[str, Array]], tuple[Array, Array]]]
    judged: tuple[tx.compositions.Composition, ...]


@dataclasses.dataclass(frozen=True)
class Kept:
    """One flight: how far what should stay has gone, relative to its size, and what a step took, us."""

    motion: str
    method: str
    changes: dict[str, float]
    step: float
    judged: bool


def motions() -> list[Motion]:
    """Heavy tops with two and with three different moments, and two free bodies."""
    top, free, tumble = SCENES["heavy-top"], SCENES["euler-top"], SCENES["offset-tumble"]
    three = (1.0, 1.3, 0.5)
    M = _spatial_inertia()
    return [
        _top("heavy top", top.dynamics, heavy_top.INERTIA),
        _top("heavy top, three moments", _asymmetric_top(three), three),
        Motion(
            "free, three moments",
            free.dynamics,
            dict(free.start),
            tx.FreeBody("R", "w", inertia=(1.0, 2.0, 3.0)),
            {"energy": _output(free.dynamics, "energy"), "momentum": _output(free.dynamics, "momentum")},
            (tx.compositions.KAHAN_LI6,),
        ),
        Motion(
            "free, offset center of mass",
            tumble.dynamics,
            dict(tumble.start),
            tx.FreeBody("g", "V", inertia=M),
            {
                "energy": _output(tumble.dynamics, "energy"),
                "momentum": _momenta(M, np.asarray(tumble.start["g"])[:3, 3]),
            },
            (tx.compositions.KAHAN_LI6,),
        ),
    ]


def flown(motion: Motion, method: Method, steps: int = STEPS, judged: bool = False) -> Kept:
    """Fly a motion twice, and time the second."""
    times = np.linspace(0.0, steps * _DT, _SAVES)

    def fly() -> Any:
        sol = tx.integrate(
            motion.dynamics, motion.start, t1=times[-1], steps=steps, method=method, save_at=times, throw=False
        )
        return jax.block_until_ready(sol.xs)

    fly()
    begin = time.perf_counter()
    xs = fly()
    seconds = time.perf_counter() - begin
    states = {name: np.asarray(value) for name, value in xs.items()}
    changes = {name: _change(*kept(states)) for name, kept in motion.kept.items()}
    return Kept(motion.name, method.name, changes, seconds / steps * 1e6, judged)


def rivals(effort: Any = FULL) -> dict[str, float]:
    """Seconds at an error of 1e-9 on the heavy top, by the name of the method, all timed in turn.

    Every flight is one small call: diffrax does not offer that, but is faster for it.
    """
    scene = SCENES["heavy-top"]
    body = tx.FreeBody("R", "w", inertia=heavy_top.INERTIA)
    line = Line("splitting", "tx.Splitting(...)", Side("twistax", "equal steps"), ("tab:blue", "-", "o"))
    contenders: list[Any] = [
        _Even(composition.name, line, tx.Splitting(composition, body))
        for composition in (tx.compositions.KAHAN_LI6, tx.compositions.KAHAN_LI8)
    ]
    contenders += [
        CONTENDERS[f"diffrax-{solver}-call{gains}"] for solver in ("tsit5", "dopri8") for gains in ("", "-pi")
    ]
    progress = Progress(sys.stderr, 1, shown=True)
    progress.start(scene.title)
    with tempfile.TemporaryDirectory() as folder:
        store = Store(Path(folder) / "rows.jsonl", origin_of(effort), Row.of)
        measure_scene(scene, contenders, effort, store, progress.tell)
        progress.end()
        empty = empty_call_seconds()
        rows = [dataclasses.replace(row, seconds=row.seconds - empty) for row in store]
    return {c.name: Curve.of(row for row in rows if row.method == c.name).time_at(ERROR) for c in contenders}


@dataclasses.dataclass(frozen=True)
class _Even(FixedSteps):
    """Equal steps, in a finer ladder than that of the report: an order of 8 falls far between its rungs."""

    def ladder(self, effort: Any) -> Ladder:
        return _Rungs(start=100, factor=2, enough=1e-11)


@dataclasses.dataclass(frozen=True)
class _Rungs(Steps):
    """Every rung a quarter more steps than the one before."""

    def after(self, setting: float, error: float) -> float | None:
        more = float(round(setting * 1.25))
        return None if error <= self.enough or more > self.most else more


def _top(name: str, dynamics: tx.Dynamics, moments: Any) -> Motion:
    J = np.asarray(moments)

    def vertical(xs: dict[str, Array]) -> tuple[Array, Array]:
        L = J * xs["w"]
        return np.einsum("ni,ni->n", xs["R"][:, 2], L), np.linalg.norm(L, axis=1)

    return Motion(
        name,
        dynamics,
        dict(SCENES["heavy-top"].start),
        tx.FreeBody("R", "w", inertia=J),
        {"energy": _output(dynamics, "energy"), "vertical momentum": vertical},
        (tx.compositions.KAHAN_LI6,),
    )


def _asymmetric_top(moments: tuple[float, ...]) -> tx.Dynamics:
    """The heavy top of the scenes with other moments."""
    J, weight = np.array(moments), np.array([0.0, 0.0, heavy_top.MOMENT])
    R, w = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,))
    return tx.compile(
        tx.System(
            rates={R: w, w: (tx.linalg.Cross(J * w, w) + tx.linalg.Cross(R[2], weight)) / J},
            outputs={"energy": 0.5 * tx.linalg.Dot(w, J * w) + heavy_top.MOMENT * R[2, 2]},
        )
    )


def _spatial_inertia() -> Array:
    m, c = offset_tumble.MASS, offset_tumble.CENTER
    arm = np.asarray(tx.lie.so3.hat(c))
    return np.block([[m * np.eye(3), -m * arm], [m * arm, offset_tumble.INERTIA - m * arm @ arm]])


def _output(dynamics: tx.Dynamics, name: str) -> Callable[[dict[str, Array]], tuple[Array, Array]]:
    def kept(xs: dict[str, Array]) -> tuple[Array, Array]:
        found = jax.vmap(lambda x: dynamics.outputs(0.0, x)[name])({n: jnp.asarray(x) for n, x in xs.items()})
        values = np.asarray(found)
        return values, np.linalg.norm(values.reshape(len(values), -1), axis=1)

    return kept


def _momenta(M: Array, about: Array) -> Callable[[dict[str, Array]], tuple[Array, Array]]:
    """Both momenta in the world, the angular one about a point.

    Its size is that of what it is the sum of: the arm, which grows with the flight, times the linear one.
    """

    def kept(xs: dict[str, Array]) -> tuple[Array, Array]:
        R, arm, mu = xs["g"][:, :3, :3], xs["g"][:, :3, 3] - about, xs["V"] @ M
        p, L = (np.einsum("nij,nj->ni", R, part) for part in (mu[:, :3], mu[:, 3:]))
        size = np.linalg.norm(p, axis=1) * (1.0 + np.linalg.norm(arm, axis=1)) + np.linalg.norm(L, axis=1)
        return np.concatenate([p, L + np.cross(arm, p)], axis=1), size

    return kept


def _change(values: Array, size: Array) -> float:
    """The largest change since the start, relative to the size at the time."""
    changes = np.linalg.norm((values - values[0]).reshape(len(values), -1), axis=1)
    return float((changes / size).max())


def _methods(motion: Motion) -> list[tuple[Method, bool]]:
    found: list[tuple[Method, bool]] = [
        (tx.Splitting(composition, motion.bodies), composition in motion.judged) for composition in tx.compositions.ALL
    ]
    return [*found, (tx.RKMK(tx.tableaus.RK4), False)]


def main() -> int:
    """Prints the tables; exit status 1 if a bar is missed."""
    jax.config.update("jax_enable_x64", True)
    # As in the report of error against run time: every flight in the caller's thread.
    jax.config.update("jax_cpu_enable_async_dispatch", False)
    print(machine())
    print(f"{STEPS:,} steps of {_DT:g} s, float64; the largest relative changes at {_SAVES - 1} times")
    print(f"{'motion':<30}{'method':<28}{'energy':>11}{'momentum':>11}{'a step, us':>12}")
    good = True
    for motion in motions():
        for method, judged in _methods(motion):
            row = flown(motion, method, judged=judged)
            held = not judged or all(change <= BARS[name] for name, change in row.changes.items())
            good = good and held
            mark = "" if not judged else "  within its bars" if held else "  A BAR IS MISSED"
            columns = "".join(f"{change:>11.1e}" for change in row.changes.values())
            print(f"{row.motion:<30}{row.method:<28}{columns}{row.step:>12.3f}{mark}", flush=True)
    print("momentum: of tops the vertical one, of the free body with an offset center both about the start")
    print(
        f"bars: energy {BARS['energy']:g}, vertical momentum {BARS['vertical momentum']:g}, full {BARS['momentum']:g}"
    )
    times = rivals()
    best = min(seconds for name, seconds in times.items() if name.startswith("diffrax"))
    print(f"heavy top, 20 s: time at an error of {ERROR:g}, each flight one small call")
    for name, seconds in times.items():
        print(f"{name:<30}{seconds * 1e3:>9.3f} ms{seconds / best:>8.2f} of the best of diffrax")
    ratio = times[tx.compositions.KAHAN_LI8.name] / best
    print(f"bar for {tx.compositions.KAHAN_LI8.name}: {BARS['time']:g}")
    good = good and ratio <= BARS["time"]
    print("all bars hold" if good else "A BAR IS MISSED")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
