"""The cost of a lookup in a table of numbers: by its points, its axes and its kind."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import twistax as tx

from ...scalar.targets.llvm.backend import installed
from ..harness.expected import between
from ..harness.measurement import MeasuredCase, Section, slow
from ..harness.timing import Race, Timed, compiled
from .scalars import need_llvmlite

_BATCH = 100_000
_LINEAR, _SPLINE = tx.tables.Linear(), tx.tables.BSpline()
_NATIVE, _XLA, _INTERP = "native", "XLA", "jnp.interp"


def looked_up(points: int, axes: int, kind: Any, even: bool) -> dict[str, Timed]:
    """A batch of places in one table, by each backend, and by `jnp.interp` where that has such a table."""
    rng = np.random.default_rng(0)
    grid = [np.linspace(-1.0, 1.0, points) if even else np.sort(rng.uniform(-1.0, 1.0, points)) for _ in range(axes)]
    values = rng.normal(size=(points,) * axes)
    x = tx.State("x", shape=(axes,))
    table = tx.Interp([x[k] for k in range(axes)], axes=grid, values=values, kind=kind)
    system = tx.System(rates={x: 0.0 * x}, outputs={"y": table})
    places = jnp.asarray(rng.uniform(-1.0, 1.0, (_BATCH, axes)))

    def by(backend: Any) -> Timed:
        dynamics = tx.compile(system, backend=backend)
        read = jax.vmap(lambda place: dynamics.outputs(0.0, {"x": place})["y"])
        return compiled(read, places, evaluations=_BATCH)

    programs = {_XLA: by(tx.XLA())} | ({_NATIVE: by(tx.Native())} if installed() else {})
    if axes == 1 and kind == _LINEAR:
        interp = lambda places: jnp.interp(places[:, 0], jnp.asarray(grid[0]), jnp.asarray(values))  # noqa: E731
        programs[_INTERP] = compiled(interp, places, evaluations=_BATCH)
    return programs


def _nanoseconds(race: Race, name: str) -> float:
    if name == _NATIVE:
        need_llvmlite()
    return race.seconds(name, 1e-9)


_TABLES: dict[str, tuple[int, int, Any, bool]] = {
    "8 points, linear": (8, 1, _LINEAR, True),
    "64 points, linear": (64, 1, _LINEAR, True),
    "1024 points, linear": (1024, 1, _LINEAR, True),
    "1024 points, uneven": (1024, 1, _LINEAR, False),
    "32 x 32 points, linear": (32, 2, _LINEAR, True),
    "32 x 32 points, B-spline": (32, 2, _SPLINE, True),
    "16 x 16 x 16 points, linear": (16, 3, _LINEAR, True),
    "16 x 16 x 16 points, B-spline": (16, 3, _SPLINE, True),
}


def _of(what: str, *table: Any) -> list[MeasuredCase]:
    race, names = Race(lambda: looked_up(*table), 1e-12), [_NATIVE, _XLA]
    names += [_INTERP] if table[1:3] == (1, _LINEAR) else []
    return [slow(what, name, between(unit="ns"), _nanoseconds, race, name) for name in names]


LOOKUPS: Section = [row for what, table in _TABLES.items() for row in _of(what, *table)]
