"""What lowering and importing cost, and how often a landing is found."""

from __future__ import annotations

import functools
import subprocess
import sys
from statistics import median

import jax
import jax.numpy as jnp

import twistax as tx

from ...lowering.explain import count_equations
from ...scenes import powered_descent, touchdown
from ..checks import Check, Section, at_least, at_most, between
from ..speed.case import CASES
from ..timing import seconds_of

_NODES = 24


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
    command = [sys.executable, "-c", code]
    return median(
        float(subprocess.run(command, capture_output=True, text=True, check=True).stdout) for _ in range(runs)
    )


def compile_seconds() -> float:
    """Seconds to build the free body of 13 states, lower it and compile one evaluation, the median of three."""
    case = CASES["free-body"]
    point = [jnp.asarray(each[0]) for each in case.points(1)]

    def build() -> None:
        dynamics = tx.compile(case.system())
        jax.jit(lambda *point: dynamics(0.0, *case.inputs(*point))).lower(*point).compile()

    return median(seconds_of(build) for _ in range(3))


COSTS = Section(
    "costs",
    [
        Check("equations of the chain", "tx.lower", lambda: chain_equations()["tx.lower"], at_most(30)),
        Check("equations of the chain", "tx.compile", lambda: chain_equations()["tx.compile"], at_most(30)),
        Check("free body: build, lower, compile", "tx.compile", compile_seconds, at_most(0.6, "s")),
        Check("`import twistax` beyond `import jax`", "median of 7 processes", import_seconds, at_most(0.3, "s")),
    ],
)

# ---- landings -------------------------------------------------------------------------------------------------------

_SEEDS = range(1, 9)


@functools.cache
def _landings() -> list[float]:
    """The final mass, kg, of each perturbed guess that lands: solved, integrated again within misses and limits."""
    problem = powered_descent.problem(tx.compile(powered_descent.system()), nodes=25)
    masses = []
    for seed in _SEEDS:
        result = problem.solve(seed=seed)
        descent = touchdown.replayed(result, tx.RKMK(tx.tableaus.RK4))
        close = touchdown.Miss.of(descent).within(touchdown.ALLOWED)
        if result.solved and close and all(r.holds for r in touchdown.reaches(descent, powered_descent.limits())):
            masses.append(result.cost)
    return masses


LANDINGS = Section(
    "landings",
    [
        Check("guesses that land", "of 8", lambda: len(_landings()), at_least(7), slow=True),
        Check("final mass of those, least", "of 8", lambda: min(_landings()), between(unit="kg"), slow=True),
        Check("final mass of those, most", "of 8", lambda: max(_landings()), between(unit="kg"), slow=True),
    ],
)
