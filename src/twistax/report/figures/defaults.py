"""Measurements of defaults: small functions as kernels in batches, long programs by XLA, checks of kinds."""

import time
from collections.abc import Callable
from statistics import median
from typing import Any

import jax.numpy as jnp
import numpy as np

import twistax as tx

from ... import mechanics
from ...mechanics import chain_models
from ..harness.expected import at_most
from ..harness.measurement import Section, quick
from ..harness.timing import Race, Repeats, Timed, batch, printed

_BATCH = 4096


def _race(expression: Callable[[mechanics.Mechanism], tx.Expr]) -> Race:
    """An output of a Panda in a batch, by default and as a native kernel."""

    def programs() -> dict[str, Timed]:
        panda = chain_models.panda()
        q = tx.State("q", shape=(panda.dofs,))
        system = tx.System(rates={q: 0.0 * q}, outputs={"value": expression(panda)})
        points = jnp.asarray(np.random.default_rng(0).normal(size=(_BATCH, panda.dofs)))

        def timed(backend: Any) -> Timed:
            dynamics = tx.compile(system, backend=backend)
            return batch(lambda q: dynamics.outputs(0.0, {"q": q})["value"], points)

        return {"tx.Native": timed(tx.Native()), "default": timed("auto")}

    return Race(programs, 1e-12, Repeats(15, 5))


_RACES = {
    "mass matrix of a Panda": _race(mechanics.mass_matrix),
    "frame Jacobian of a Panda": _race(lambda panda: mechanics.frame_jacobian(panda, panda.links[-1].name)),
}

_LINES = """
import time, jax, jax.numpy as jnp, twistax as tx
jax.config.update("jax_enable_x64", True)
def lines(x):
    for k in range(200):
        x = jnp.sin(x) * (0.5 + 1e-3 * k) + 0.1 * x * x
    return x
def seconds(compiler, function):
    begin = time.process_time()
    compiler(function)(jnp.ones(12)).block_until_ready()
    return time.process_time() - begin
for compiler in (tx.fast, jax.jit):
    seconds(compiler, lambda x: x * x)
print(seconds(tx.fast, lines) / seconds(jax.jit, lines))
"""


def compiling_lines() -> float:
    """The processor time of `tx.fast` to compile 200 elementwise lines on 12 states over that of `jax.jit`."""
    return median(printed(_LINES, TWISTAX_CACHE="off", JAX_PLATFORMS="cpu") for _ in range(3))


def checking_kinds(runs: int = 15) -> float:
    """The part of the processor time to build the dynamics of a Panda with a declared kind that checks take."""
    panda = chain_models.panda()

    def seconds(**declared: Any) -> float:
        q, qd = (tx.State(name, shape=(panda.dofs,)) for name in ("q", "qd"))
        tau = tx.Control("tau", shape=(panda.dofs,), **declared)
        begin = time.process_time()
        tx.System(rates={q: qd, qd: mechanics.forward_dynamics(panda, q, qd, tau)})
        return time.process_time() - begin

    pairs = [(seconds(), seconds(unit="N m")) for _ in range(runs)]
    plain, checked = (min(times) for times in zip(*pairs, strict=True))  # other processes only add to them
    return 1.0 - plain / checked


DEFAULTS: Section = [
    *(
        quick(f"{what}, batch of {_BATCH:,}: time over tx.Native()", by, at_most(1.1), race.ratio, by, "tx.Native")
        for what, race in _RACES.items()
        for by in ("default",)
    ),
    quick("200 elementwise lines on 12 states: compile over jax.jit", "tx.fast", at_most(3.0), compiling_lines),
    quick("check of kinds: share of the time to build a Panda", "tx.System", at_most(0.1), checking_kinds),
]
