"""The free body with kinematics, one evaluation in a `lax.scan`, against OpenSCvx's lowering of the same system.

`python -m twistax.report.scan_speed` prints the times, the ratio and the time to compile. Without OpenSCvx in the
environment it says so and prints the rest. Exit status 1 if the results disagree or a figure is above its bar.

Both write the same thirteen states with the same nodes: position, quaternion, linear and angular velocity, with a full
inertia M as an input. Two forms: with M^-1 as another input, and with M inverted at every evaluation (Solve here, Inv
there, which has no Solve). The coadjoint operator of OpenSCvx 0.5.2 is right for a twist [v; w] if the momentum is
ordered [L; p], so there the rows of M are exchanged; the work is the same.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..expr import QDCM, SSMP, Control, Parameter, State
from ..expr.lie import AdjointDual
from ..expr.solve import Solve
from ..lowering import Dynamics, compile
from ..system import System
from .conservation import spatial_inertia
from .machine import machine

__all__ = ["COMPILE_BAR", "RATIO_BAR", "main", "measure"]

COMPILE_BAR = 0.6
"""Seconds to build, lower and compile the free body of thirteen states."""

RATIO_BAR = 1.0
"""Time of twistax over time of OpenSCvx, median over the rounds of one run."""

_EVALUATIONS = 20_000
_ROUNDS = 41
_SWAP = [3, 4, 5, 0, 1, 2]

Start = dict[str, np.ndarray]
Rate = Callable[[Any, Any, Any], Any]


@dataclass(frozen=True)
class Contender:
    """A way to evaluate the free body.

    Attributes:
        name: how the table calls it.
        rate: (state, wrench, params) -> the state's derivative, of the state's own structure.
        state, wrench, params: its inputs.
        read: the derivative as thirteen numbers, to compare results.
    """

    name: str
    rate: Rate
    state: Any
    wrench: jax.Array
    params: Any
    read: Callable[[Any], np.ndarray]


def start() -> Start:
    """A tumbling start, by state name."""
    q = np.array([0.5, 0.1, -0.7, 0.5])
    return {
        "p": np.array([0.5, -1.0, 2.0]),
        "q": q / np.linalg.norm(q),
        "V": np.array([1.0, 0.5, -0.3, 0.4, 2.0, -0.7]),
    }


WRENCH = np.array([0.1, -0.2, 0.3, 0.05, 0.01, -0.02])


def quaternion_body(solve: bool) -> Dynamics:
    """p' = R(q) v, q' = q (0, w) / 2, V' = M^-1 (F - ad*_V M V), by Solve or with M^-1 as a parameter."""
    p, q, V = State("p", shape=(3,)), State("q", shape=(4,)), State("V", shape=(6,))
    F = Control("F", shape=(6,))
    M, inverse = Parameter("M", shape=(6, 6)), Parameter("inverse", shape=(6, 6))
    net = F - AdjointDual(V, M @ V)
    acceleration = Solve(M, net) if solve else inverse @ net
    return compile(
        System(rates={p: QDCM(q) @ V[:3], q: 0.5 * SSMP(V[3:]) @ q, V: acceleration}, parameters=[M, inverse])
    )


def contenders(solve: bool) -> list[Contender]:
    """twistax, and OpenSCvx where it is installed."""
    inertia = spatial_inertia()
    params = {"M": jnp.asarray(inertia), "inverse": jnp.asarray(np.linalg.inv(inertia))}
    dynamics = quaternion_body(solve)
    state = {name: jnp.asarray(value) for name, value in start().items()}
    found = [
        Contender(
            "twistax",
            lambda x, wrench, params: dynamics._functions.vector_field(jnp.zeros(()), x, {"F": wrench}, params),
            state,
            jnp.asarray(WRENCH),
            params,
            lambda rate: np.concatenate([rate["p"], rate["q"], rate["V"]]),
        )
    ]
    other = _openscvx(solve)
    if other is not None:
        swap = jnp.array(_SWAP)
        exchanged = {"M": params["M"][swap], "inverse": params["inverse"][:, swap]}
        flat = jnp.concatenate([state["p"], state["q"], state["V"]])
        found.append(Contender("OpenSCvx", other, flat, jnp.asarray(WRENCH)[swap], exchanged, np.asarray))
    return found


def _openscvx(solve: bool) -> Rate | None:
    """OpenSCvx's lowering of the quaternion body on flat vectors; None where it is not installed."""
    try:
        import openscvx as ox
        from openscvx.symbolic.lower import lower_to_jax
    except ImportError:
        return None
    p, q, V = ox.State("p", shape=(3,)), ox.State("q", shape=(4,)), ox.State("V", shape=(6,))
    F = ox.Control("F", shape=(6,))
    for leaf, place in ((p, slice(0, 3)), (q, slice(3, 7)), (V, slice(7, 13)), (F, slice(0, 6))):
        leaf._slice = place
    M, inverse = (ox.Parameter(name, shape=(6, 6), value=np.eye(6)) for name in ("M", "inverse"))
    acceleration = (ox.linalg.Inv(M) if solve else inverse) @ (F - ox.lie.AdjointDual(V, M @ V))
    rates = ox.Concat(ox.spatial.QDCM(q) @ V[:3], 0.5 * ox.spatial.SSMP(V[3:]) @ q, acceleration)
    lowered = lower_to_jax(rates)
    return lambda x, wrench, params: lowered(x, wrench, 0, params)


def _loop(contender: Contender) -> Callable[[], None]:
    """A compiled scan that feeds each evaluation into the next."""

    @jax.jit
    def run(state: Any, wrench: jax.Array, params: Any) -> Any:
        def step(x: Any, _: None) -> tuple[Any, None]:
            return jax.tree.map(lambda a, b: a + 1e-6 * b, x, contender.rate(x, wrench, params)), None

        return jax.lax.scan(step, state, None, length=_EVALUATIONS)[0]

    return lambda: jax.block_until_ready(run(contender.state, contender.wrench, contender.params))


def measure(found: list[Contender]) -> dict[str, list[float]]:
    """Nanoseconds an evaluation for every contender, rounds in turn so that load falls on all alike."""
    loops = {contender.name: _loop(contender) for contender in found}
    for loop in loops.values():
        loop()
    times: dict[str, list[float]] = {name: [] for name in loops}
    for _ in range(_ROUNDS):
        for name, loop in loops.items():
            begin = time.perf_counter()
            loop()
            times[name].append((time.perf_counter() - begin) / _EVALUATIONS * 1e9)
    return times


def compile_seconds() -> float:
    """Seconds to build the system, lower it and compile one evaluation; JAX itself is awake already."""
    jax.block_until_ready(jnp.zeros(3) + 1.0)
    x = {name: jnp.asarray(value) for name, value in start().items()}
    params = {"M": jnp.eye(6), "inverse": jnp.eye(6)}
    begin = time.perf_counter()
    dynamics = quaternion_body(solve=False)
    jax.jit(dynamics._functions.vector_field).lower(jnp.zeros(()), x, {"F": jnp.zeros(6)}, params).compile()
    return time.perf_counter() - begin


def agreement(found: list[Contender]) -> float:
    """The largest difference between the contenders' derivatives."""
    rates = [each.read(jax.jit(each.rate)(each.state, each.wrench, each.params)) for each in found]
    return max(float(np.abs(rate - rates[0]).max()) for rate in rates)


def main() -> int:
    """Prints the figures; exit status 1 if results disagree or a bar is missed."""
    jax.config.update("jax_enable_x64", True)
    seconds = median(compile_seconds() for _ in range(3))
    print(machine())
    print(f"free body, 13 states: build, lower and compile {seconds:.2f} s (bar {COMPILE_BAR} s)")
    print(
        f"one evaluation in a scan of {_EVALUATIONS}, ns, median of {_ROUNDS} rounds in turn (ratio bar {RATIO_BAR:g}):"
    )
    held = seconds < COMPILE_BAR
    for solve, form in ((False, "inverse given"), (True, "M inverted")):
        found = contenders(solve)
        difference = agreement(found)
        times = measure(found)
        line = ", ".join(f"{name} {median(each):.0f}" for name, each in times.items())
        if "OpenSCvx" in times:
            # Round by round: both saw the same load.
            ratio = median(ours / theirs for ours, theirs in zip(times["twistax"], times["OpenSCvx"], strict=True))
            held = held and ratio <= RATIO_BAR and difference < 1e-12
            line += f", ratio {ratio:.2f}, results differ by {difference:.0e}"
        print(f"  {form:<15}{line if len(found) > 1 else line + ', OpenSCvx is absent'}")
    print("all bars hold" if held else "A BAR IS MISSED")
    return 0 if held else 1


if __name__ == "__main__":
    sys.exit(main())
