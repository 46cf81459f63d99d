"""The cost of lowering and importing, the success rate of landings, and integration times compared with diffrax."""

import dataclasses
import functools
import math
import tempfile
from pathlib import Path
from statistics import median
from typing import Any

import jax
import jax.numpy as jnp

import twistax as tx

from ...scenes import SCENES, heavy_top, powered_descent, touchdown
from ...system.explain import count_equations
from ..harness.expected import at_most, between
from ..harness.measurement import MeasuredCase, Section, quick, slow
from ..harness.rows import plain
from ..harness.store import Origin, Store
from ..harness.timing import empty_call_seconds, printed, seconds_of
from ..speed.cases import CASES
from ..work_precision.findings import Curve
from ..work_precision.integrators import FULL, INTEGRATORS, Integrator, equal_steps, measure_scene, ours, tolerances

_NODES = 24


@functools.cache
def chain_equations() -> dict[str, int]:
    """Equations of a chain of 24 nodes, each of which uses the one before twice or folds it by a sine.

    As a lone expression and as the rate of a compiled system.
    """
    x = tx.State("x", shape=(3,))
    node: tx.Expr = x
    for i in range(_NODES):
        node = tx.Sin(node) if i % 3 == 2 else node + node if i % 3 else node * node
    dynamics = tx.compile(tx.System(rates={x: node}))
    forms = {"tx.lower": lambda v: tx.lower(node)(0.0, v), "tx.compile": lambda v: dynamics(0.0, v)}
    return {name: count_equations(jax.make_jaxpr(form)({"x": jnp.ones(3)}).jaxpr) for name, form in forms.items()}


def import_seconds(runs: int = 7) -> float:
    """Median over fresh processes of the time `import twistax` takes once JAX is imported."""
    code = "import time, jax; t = time.perf_counter(); import twistax; print(time.perf_counter() - t)"
    return median(printed(code) for _ in range(runs))


def compile_seconds() -> float:
    """Seconds to build the free body of 13 states, lower it and compile one evaluation, the median of three."""
    case = CASES["free-body"]
    point = [jnp.asarray(values[0]) for values in case.points(1)]

    def build() -> None:
        dynamics = tx.compile(case.system())
        jax.jit(lambda *point: dynamics(0.0, *case.inputs(*point))).lower(*point).compile()

    return median(seconds_of(build) for _ in range(3))


_START = """
import jax, numpy as np, twistax as tx
from twistax.scalar.targets.llvm.backend import KERNEL_EVENT
from twistax.mechanics import chain_models, forward_dynamics
jax.config.update("jax_enable_x64", True)
spent = [0.0]
jax.monitoring.register_event_duration_secs_listener(lambda e, s, **_: spent.append(s) if e == KERNEL_EVENT else None)
arm = chain_models.panda()
q, qd, tau = tx.State("q", shape=(7,)), tx.State("qd", shape=(7,)), tx.Control("tau", shape=(7,))
dynamics = tx.compile(tx.System(rates={q: qd, qd: forward_dynamics(arm, q, qd, tau)}))
tx.integrate(dynamics, {"q": np.full(7, 0.3), "qd": np.zeros(7)}, t1=0.01, dt=1e-3, u={"tau": np.zeros(7)})
print(sum(spent))
"""


@functools.cache
def _starts() -> list[float]:
    """The seconds that a script of the Panda spends on kernels when it first starts, and the second time."""
    with tempfile.TemporaryDirectory() as folder:
        return [printed(_START, TWISTAX_CACHE=folder, JAX_PLATFORMS="cpu") for _ in range(2)]


COSTS: Section = [
    quick("equations of the chain", "tx.lower", at_most(30), lambda: chain_equations()["tx.lower"]),
    quick("equations of the chain", "tx.compile", at_most(30), lambda: chain_equations()["tx.compile"]),
    quick("free body: build, lower, compile", "tx.compile", at_most(0.6, "s"), compile_seconds),
    quick("`import twistax` beyond `import jax`", "median of 7 processes", at_most(0.3, "s"), import_seconds),
    quick("kernel of the Panda's steps", "first start", between(unit="s"), lambda: _starts()[0]),
    quick("kernel of the Panda's steps", "second start", at_most(0.1, "s"), lambda: _starts()[1]),
]


@functools.cache
def _landings() -> list[float]:
    """The final mass, kg, of each of 8 perturbed guesses that lands: solved, integrated again within misses, limits."""
    problem, masses = powered_descent.problem(tx.compile(powered_descent.system()), nodes=25), []
    for seed in range(1, 9):
        result = problem.solve(seed=seed)
        descent = touchdown.replayed(result, tx.RKMK(tx.tableaus.RK4))
        close = touchdown.Miss.of(descent).within(touchdown.ALLOWED)
        if result.solved and close and all(r.holds for r in touchdown.reaches(descent, powered_descent.limits())):
            masses.append(result.cost)
    return masses


LANDINGS: Section = [
    slow("guesses that land", "of 8", between(7.0), lambda: len(_landings())),
    slow("smallest final mass of those", "of 8", between(unit="kg"), lambda: min(_landings())),
    slow("largest final mass of those", "of 8", between(unit="kg"), lambda: max(_landings())),
]

#: A finer ladder than that of the report: an order of 8 falls far between its rungs.
_EFFORT = dataclasses.replace(FULL, tolerances=tolerances(-2, -12, 4), steps=equal_steps(100, 1.25), enough=1e-11)
_RADAU5, _RADAU9, _KAHAN_LI8 = tx.tableaus.RADAU_IIA5, tx.tableaus.RADAU_IIA9, tx.compositions.KAHAN_LI8


@functools.cache
def _integrators(scene: str) -> list[Integrator]:
    """The integrators of a scene, ours first. On the top diffrax runs as one small call: it does not offer that, but is
    faster for it."""
    if scene == "stiff-attitude":
        radau = [ours(tableau.name, tx.ImplicitRKMK(tableau)) for tableau in (_RADAU5, _RADAU9)]
        return [*radau, INTEGRATORS["diffrax-kvaerno5-pi"]]
    body = tx.FreeBody("R", "w", inertia=heavy_top.INERTIA)
    names = (f"diffrax-{solver}-call{gains}" for solver in ("tsit5", "dopri8") for gains in ("", "-pi"))
    splitting = ours(_KAHAN_LI8.name, tx.Splitting(_KAHAN_LI8, body), equal=True)
    return [splitting, *(INTEGRATORS[name] for name in names)]


@functools.cache
def race(scene: str) -> dict[str, Curve]:
    """The curve of each method, by name, all timed in turn; what a call costs that does nothing is taken off."""
    with tempfile.TemporaryDirectory() as folder:
        store = Store(Path(folder) / "rows.json", Origin.now({}))
        measure_scene(SCENES[scene], _integrators(scene), _EFFORT, store)
    empty = empty_call_seconds()
    rows = [dataclasses.replace(row, value=row.value - empty) for row in store]
    return {it.name: Curve.of(row for row in rows if row.by == it.name) for it in _integrators(scene)}


def _ratio(scene: str, method: str, error: float) -> float:
    """The time of a method at an error over that of the best of diffrax; NaN where it does not get there."""
    times = {name: curve.time_at(error) for name, curve in race(scene).items()}
    best = min(time for name, time in times.items() if name.startswith("diffrax") and math.isfinite(time))
    return times[method] / best


def _race(title: str, scene: str, method: Any, error: float, limit: float = math.inf) -> MeasuredCase:
    what = f"{title}, error {plain(error)}"
    return slow(what, method.name, between(high=limit), _ratio, scene, method.name, error)


RACES: Section = [
    _race("heavy top", "heavy-top", _KAHAN_LI8, 1e-9, 0.5),
    _race("stiff attitude hold", "stiff-attitude", _RADAU5, 1e-6, 0.15),
    _race("stiff attitude hold", "stiff-attitude", _RADAU9, 1e-6, 0.15),
    _race("stiff attitude hold", "stiff-attitude", _RADAU5, 1e-9),
    _race("stiff attitude hold", "stiff-attitude", _RADAU9, 1e-9, 0.05),
]
