"""Radau IIA on a stiff attitude hold: time at an error beside diffrax, every rate, the order seen, the gradient.

`python -m twistax.report.stiff_speed` prints the tables. Exit status 1 if a bar is missed. `--quick` leaves out the
gradient, which takes most of the time.

Ours are Radau IIA of three stages (order 5) and of five (order 9). The peer is diffrax's Kvaerno5 with a PI controller,
on quaternions. All run in one jit each, with the tolerance as input, and each at the tolerance of its ladder that
reaches the error soonest. Ours are one small function each (see docs/integrating.md); Kvaerno5 calls a library in every
step, which no small function can, so it runs as it is.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from ..diffrax import ambient_term
from ..integrators import ImplicitRKMK, StepControl, integrate
from ..integrators.implicit import RADAU_IIA5, RADAU_IIA9, CollocationTableau
from ..lowering import Dynamics, compile
from ..lowering.small_call import fits
from ..scenes import stiff_attitude
from .machine import machine

__all__ = ["GRADIENT_BAR", "ORDER_BAR", "SPEED_BARS", "Run", "best", "main", "order_seen"]

#: Error -> the largest ratio of our time to the peer's.
SPEED_BARS = {1e-6: 0.15, 1e-9: 0.05}
#: Relative to the largest entry of the gradient.
GRADIENT_BAR = 1e-6
#: How far the order seen on a smooth problem may be from the one stated.
ORDER_BAR = 0.2

_RATE = 1e5
_ROUNDS = 5
#: Seconds of calls in a round.
_ROUND = 0.03
_LADDER = tuple(10.0 ** (-2.0 - 0.25 * i) for i in range(29))
_METHOD = ImplicitRKMK(RADAU_IIA5)
#: Those in the race for time.
_OURS, _PEER = (RADAU_IIA5, RADAU_IIA9), "Kvaerno5"

#: tolerance -> (the end by name, the number of steps tried).
Flight = Callable[[jax.Array], tuple[dict[str, jax.Array], jax.Array]]


@dataclass(frozen=True)
class Run:
    """One flight: its tolerance, the error of its end, milliseconds, and steps."""

    tolerance: float
    error: float
    milliseconds: float
    steps: int


def error_of(end: dict[str, Any], reference: Any) -> float:
    """The largest difference of an entry."""
    return max(float(np.abs(np.asarray(end[name]) - value).max()) for name, value in reference.items())


def contenders(dynamics: Dynamics) -> dict[str, Flight]:
    """Ours and the peer."""
    scene = stiff_attitude.scene(_RATE)
    term = ambient_term(dynamics)
    start = term.to_ambient(scene.start)

    def ours(tableau: CollocationTableau) -> Flight:
        def fly(tolerance: jax.Array) -> tuple[dict[str, jax.Array], jax.Array]:
            sol = integrate(
                dynamics,
                scene.start,
                t1=scene.duration,
                rtol=tolerance,
                atol=tolerance,
                method=ImplicitRKMK(tableau),
                params=scene.params,
            )
            return {name: value[-1] for name, value in sol.xs.items()}, sol.stats.steps

        return fly

    def peer(tolerance: jax.Array) -> tuple[dict[str, jax.Array], jax.Array]:
        sol = diffrax.diffeqsolve(
            term,
            diffrax.Kvaerno5(),
            0.0,
            scene.duration,
            None,
            start,
            args=(None, scene.params),
            stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=tolerance, pcoeff=0.4, icoeff=0.3),
            max_steps=16384,
            throw=False,
        )
        ys: Any = sol.ys
        return term.from_ambient({name: value[-1] for name, value in ys.items()}), sol.stats["num_steps"]

    return {**{tableau.name: ours(tableau) for tableau in _OURS}, _PEER: peer}


def best(runs: list[Run], error: float) -> Run:
    """The fastest run that reaches an error."""
    reached = [run for run in runs if run.error <= error]
    if not reached:
        raise RuntimeError(f"no tolerance of the ladder reaches an error of {error:g}")
    return min(reached, key=lambda run: run.milliseconds)


def _milliseconds(run: Callable[[jax.Array], Any], tolerance: jax.Array) -> float:
    """A call, as the mean of as many as fill the time of a round: one alone is shorter than a switch of processes."""
    calls, begin = 0, time.perf_counter()
    while (spent := time.perf_counter() - begin) < _ROUND or not calls:
        jax.block_until_ready(run(tolerance))
        calls += 1
    return 1e3 * spent / calls


def _speeds(dynamics: Dynamics) -> bool:
    reference = stiff_attitude.scene(_RATE).reference
    flights = contenders(dynamics)
    print(f"the peer fits a small function: {fits(flights[_PEER], jnp.asarray(1e-6))}")
    compiled: dict[str, Any] = {}
    runs: dict[str, list[Run]] = {}
    for name, flight in flights.items():
        begin = time.perf_counter()
        compiled[name] = jax.jit(flight).lower(jnp.asarray(1e-6)).compile()
        seconds = time.perf_counter() - begin
        print(f"{name}: compiled in {seconds:.1f} s")
        runs[name] = []
    times: dict[tuple[str, float], list[float]] = {}
    for _ in range(_ROUNDS):
        for tolerance in _LADDER:
            for name, run in compiled.items():
                times.setdefault((name, tolerance), []).append(_milliseconds(run, jnp.asarray(tolerance)))
    for (name, tolerance), found in times.items():
        end, steps = compiled[name](jnp.asarray(tolerance))
        runs[name].append(Run(tolerance, error_of(end, reference), median(found), int(steps)))
    print(f"{'tolerance':<12}" + "".join(f"{name + ': error':>22}{'steps':>8}{'ms':>9}" for name in runs))
    for row in zip(*runs.values(), strict=True):
        print(
            f"{row[0].tolerance:<12.1e}"
            + "".join(f"{run.error:>22.1e}{run.steps:>8}{run.milliseconds:>9.3f}" for run in row)
        )
    good = True
    for error, bar in SPEED_BARS.items():
        peer = best(runs[_PEER], error)
        print(f"at error {error:g}: {_PEER} {peer.milliseconds:.3f} ms ({peer.steps} steps)")
        ratios = []
        for name in (tableau.name for tableau in _OURS):
            own = best(runs[name], error)
            ratios.append(own.milliseconds / peer.milliseconds)
            print(f"  {name}: {own.milliseconds:.3f} ms ({own.steps} steps), ratio {ratios[-1]:.3f}")
        print(f"  the smaller ratio against its bar: {min(ratios):.3f}, {bar:g}")
        good = good and min(ratios) < bar
    return good


def _rates(dynamics: Dynamics) -> bool:
    """Every rate, at four tolerances; and steps of a second: at 1e8 step times rate is 1e8."""
    print("\nerror by rate and tolerance, steps in brackets; last, five steps of 1 s each")
    good = True
    for rate in stiff_attitude.RATES:
        scene = stiff_attitude.scene(rate)
        cells, errors = [], []
        for options in ({"rtol": 1e-4}, {"rtol": 1e-6}, {"rtol": 1e-8}, {"rtol": 1e-10}, {"steps": 5}):
            sol = integrate(dynamics, scene.start, t1=scene.duration, params=scene.params, method=_METHOD, **options)
            errors.append(error_of({name: value[-1] for name, value in sol.xs.items()}, scene.reference))
            cells.append(f"{errors[-1]:.1e} ({sol.stats.steps})")
        bounded = all(e <= tolerance for e, tolerance in zip(errors, (1e-4, 1e-6, 1e-8, 1e-10), strict=False))
        good = good and bounded and errors[-1] < 0.05
        print(f"{rate:<10.0e}" + "".join(f"{cell:>18}" for cell in cells))
    return good


def order_seen(dynamics: Dynamics, rate: float, counts: tuple[int, ...]) -> tuple[float, list[float]]:
    """The slope of log error over log step with these numbers of equal steps, and the errors."""
    scene = stiff_attitude.scene(rate)
    if scene.reference is None:
        tight = integrate(dynamics, scene.start, t1=5.0, rtol=3e-14, params=scene.params)
        reference = {name: value[-1] for name, value in tight.xs.items()}
    else:
        reference = dict(scene.reference)
    errors = []
    for count in counts:
        sol = integrate(dynamics, scene.start, t1=scene.duration, steps=count, params=scene.params, method=_METHOD)
        errors.append(error_of({name: value[-1] for name, value in sol.xs.items()}, reference))
    return float(-np.polyfit(np.log(counts), np.log(errors), 1)[0]), errors


def _orders(dynamics: Dynamics) -> bool:
    print("\norder seen with equal steps; below 5 where the rate times the step is neither small nor large")
    good = True
    for rate in (1.0, 1e2, 1e3, 1e4, 1e5):
        counts = (32, 45, 64, 90) if rate == 1.0 else (40, 80, 160)
        order, errors = order_seen(dynamics, rate, counts)
        good = good and (rate > 1.0 or abs(order - 5.0) < ORDER_BAR)
        print(
            f"rate {rate:<8.0e} order {order:.2f}   "
            + "  ".join(f"{n} steps {e:.1e}" for n, e in zip(counts, errors, strict=True))
        )
    return good


def _gradients(dynamics: Dynamics) -> bool:
    """Of a weighted sum of the end with respect to the start, in the tangent space, and log k."""
    scene = stiff_attitude.scene(_RATE)
    start = {name: jnp.asarray(value) for name, value in scene.start.items()}
    weights = jnp.asarray(np.random.default_rng(0).normal(size=6))

    def cost(z: jax.Array, rate: jax.Array) -> jax.Array:
        sol = integrate(
            dynamics,
            dynamics.retract(start, z[:6]),
            t1=1.0,
            rtol=1e-11,
            atol=1e-11,
            method=_METHOD,
            params={"k": rate * jnp.exp(z[6])},
            control=StepControl(max_steps=2048),
        )
        return weights @ dynamics.difference(start, {name: value[-1] for name, value in sol.xs.items()})

    begin = time.perf_counter()
    gradient = jax.jit(jax.grad(cost)).lower(jnp.zeros(7), jnp.asarray(1.0)).compile()
    print(f"\ngradient against differences; compiled in {time.perf_counter() - begin:.1f} s")
    run, good, h = jax.jit(cost), True, 2e-3
    for k in stiff_attitude.RATES:
        rate = jnp.asarray(k)
        found = gradient(jnp.zeros(7), rate)
        differences = jnp.stack(
            [
                (8.0 * (run(e, rate) - run(-e, rate)) - (run(2.0 * e, rate) - run(-2.0 * e, rate))) / (12.0 * h)
                for e in h * jnp.eye(7)
            ]
        )
        off = float(jnp.abs(found - differences).max() / jnp.abs(found).max())
        good = good and off < GRADIENT_BAR
        print(f"rate {k:<8.0e} off by {off:.1e}, bar {GRADIENT_BAR:g}")
    return good


def main() -> int:
    """Prints the tables."""
    jax.config.update("jax_enable_x64", True)
    # Handing a call to another thread costs as much as a short flight.
    jax.config.update("jax_cpu_enable_async_dispatch", False)
    print(machine())
    print(f"attitude hold, 5 s, float64; medians of {_ROUNDS} rounds in turn; rate {_RATE:g} for the times")
    dynamics = compile(stiff_attitude.system())
    parts = [_speeds, _rates, _orders] + ([] if "--quick" in sys.argv[1:] else [_gradients])
    held = [part(dynamics) for part in parts]
    print("all bars hold" if all(held) else "A BAR IS MISSED")
    return 0 if all(held) else 1


if __name__ == "__main__":
    sys.exit(main())
