"""A stiff attitude hold: its errors at every rate, the order seen, and the gradient through Radau IIA."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import twistax as tx

from ...scenes import stiff_attitude
from ..checks import Check, Expected, Section, at_most, between, simulated
from ..rows import plain

_RADAU = tx.ImplicitRKMK(tx.tableaus.RADAU_IIA5)
_TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10)


@functools.cache
def _dynamics() -> tx.Dynamics:
    return tx.compile(stiff_attitude.system())


def _ends(rate: float, **steps: Any) -> dict[str, Any]:
    scene = stiff_attitude.scene(rate)
    sol = simulated(_dynamics(), scene.start, t1=scene.duration, params=scene.params, **{"method": _RADAU} | steps)
    return {name: value[-1] for name, value in sol.xs.items()}


def _error(rate: float, reference: Any = None, **steps: Any) -> float:
    """The largest difference of an entry."""
    end, wanted = _ends(rate, **steps), reference or stiff_attitude.scene(rate).reference or {}
    return max(float(np.abs(np.asarray(end[name]) - value).max()) for name, value in wanted.items())


def _over_tolerance() -> float:
    """The worst error over its tolerance."""
    return max(_error(rate, rtol=tol) / tol for rate in stiff_attitude.RATES for tol in _TOLERANCES)


@functools.cache
def order_seen(rate: float) -> float:
    """The slope of log error over log step with some numbers of equal steps."""
    counts = (32, 45, 64, 90) if rate == 1.0 else (40, 80, 160)
    reference = stiff_attitude.scene(rate).reference or _ends(rate, rtol=3e-14, method=tx.RKMK(tx.tableaus.TSIT5))
    errors = [_error(rate, reference, steps=count) for count in counts]
    return float(-np.polyfit(np.log(counts), np.log(errors), 1)[0])


def fourth_order(run: Callable[[jax.Array], jax.Array], size: int, h: float) -> jax.Array:
    """The gradient at zero by central differences of fourth order."""
    steps = h * jnp.eye(size)
    four = [8.0 * (run(e) - run(-e)) - (run(2.0 * e) - run(-2.0 * e)) for e in steps]
    return jnp.stack(four) / (12.0 * h)


def _gradient() -> float:
    """Reverse mode against differences of fourth order, relative to the largest entry, the worst of all rates.

    Of a weighted sum of the end with respect to the start, in the tangent space, and log k.
    """
    dynamics = _dynamics()
    start = {name: jnp.asarray(value) for name, value in stiff_attitude.scene(1e5).start.items()}
    weights = jnp.asarray(np.random.default_rng(0).normal(size=6))
    options: dict[str, Any] = {"rtol": 1e-11, "atol": 1e-11, "control": tx.StepControl(max_steps=2048)}

    def cost(z: jax.Array, rate: jax.Array) -> jax.Array:
        x, params = dynamics.retract(start, z[:6]), {"k": rate * jnp.exp(z[6])}
        sol = tx.integrate(dynamics, x, t1=1.0, method=_RADAU, params=params, **options)
        return weights @ dynamics.difference(start, {name: value[-1] for name, value in sol.xs.items()})

    run, gradient, worst = jax.jit(cost), jax.jit(jax.grad(cost)), []
    for rate in map(jnp.asarray, stiff_attitude.RATES):
        found, wanted = gradient(jnp.zeros(7), rate), fourth_order(lambda z, rate=rate: run(z, rate), 7, 2e-3)  # type: ignore[misc]
        worst.append(float(jnp.abs(found - wanted).max() / jnp.abs(found).max()))
    return float(np.max(worst))


def _radau(what: str, measure: Any, expected: Expected = between(), slow: bool = True) -> Check:  # noqa: B008  frozen
    return Check(what, "Radau IIA 5", measure, expected, slow)


STIFFNESS = Section(
    "stiffness",
    [
        _radau(
            "rates 1e2 to 1e8, rtol 1e-4 to 1e-10, 28 runs: error over tolerance, worst", _over_tolerance, at_most(1.0)
        ),
        _radau("five steps of 1 s at rate 1e8: error", lambda: _error(1e8, steps=5), at_most(0.05), slow=False),
        _radau("order at rate 1, equal steps", lambda: order_seen(1.0), between(4.8, 5.2)),
        _radau("gradient against differences, rates 1e2 to 1e8: worst", _gradient, at_most(1e-6)),
        "Where the rate times the step is neither small nor large the order is lower, as that of the stages is 3.",
        *[_radau(f"order at rate {plain(r)}", functools.partial(order_seen, r)) for r in (1e2, 1e3, 1e4, 1e5)],
    ],
)
