"""Derivatives of steps and of whole integrations: how well they agree with other ways to them, and what they cost."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import twistax as tx

from ...integrators import VectorField
from ...scenes.powered_descent import Start, Vehicle, initial, system
from ...scenes.rocket import ROCKET
from ...trajectory import discretize
from ..checks import Check, Section, agree, at_most, between
from ..timing import Repeats, Timed, compiled, in_turn
from .stiffness import fourth_order

_RK4 = tx.RKMK(tx.tableaus.RK4)
_REPEATS = Repeats(5, 5)

# ---- of a step ------------------------------------------------------------------------------------------------------

_STEP, _BATCH = 0.5, 24
_CLOSED, _LOGARITHM, _DIFFERENCES = "closed form", "jacfwd of the logarithm", "Richardson differences"


@functools.cache
def linearised() -> tuple[dict[str, Timed], dict[str, float]]:
    """A, B and dx/dh of a batch of intervals three ways, timed, and how far two are from the closed form.

    A rocket stage: a pose, a body twist and a mass under thrust, 0.5 s. Differences are of the largest entry, with the
    unknowns in their scales. Needs JAX's x64 switch.
    """
    dynamics, rng, vehicle = tx.compile(system()), np.random.default_rng(0), Vehicle()
    n, leaves = dynamics.dimension, (*system().states, *system().controls)
    sizes = [(leaf.group.dimension,) if hasattr(leaf, "group") else leaf.shape for leaf in leaves]
    scales = [np.broadcast_to(np.asarray(leaf.scale), size).ravel() for leaf, size in zip(leaves, sizes, strict=True)]
    scale = np.concatenate([*scales, [_STEP]])
    # States around the start of the descent and thrusts around 60 %, leading axis the batch.
    moves = 0.3 * rng.normal(size=(_BATCH, n)) * scale[:n]
    xs = jax.jit(jax.vmap(dynamics.retract, (None, 0)))(initial(Start(), vehicle), moves)
    thrusts = vehicle.max_thrust * (np.array([0.0, 0.0, 0.6]) + 0.1 * rng.normal(size=(_BATCH, 3)))

    def closed(x: Any, u: Any) -> jax.Array:
        step = discretize(dynamics, 0.0, x, u, _STEP)
        return jnp.concatenate([step.A, step.B, step.h_derivative[:, None]], axis=1)

    def by_logarithm(x: Any, u: Any) -> jax.Array:
        return jax.jacfwd(_moved_end(dynamics, x, u))(jnp.zeros(n + 4))

    def by_differences(x: Any, u: Any) -> jax.Array:
        end = jax.vmap(_moved_end(dynamics, x, u))

        def central(size: float) -> jax.Array:
            steps = size * jnp.diag(jnp.asarray(scale))
            return (end(steps) - end(-steps)).T / (2.0 * size * scale[None, :])

        return (4.0 * central(5e-4) - central(1e-3)) / 3.0

    ways = {_CLOSED: closed, _LOGARITHM: by_logarithm, _DIFFERENCES: by_differences}
    arguments = xs, {"T": jnp.asarray(thrusts)}
    timed = {name: compiled(jax.vmap(way), *arguments, evaluations=_BATCH) for name, way in ways.items()}
    results = {name: np.asarray(each.result()) for name, each in timed.items()}
    differences = {
        name: np.abs(results[_CLOSED] - values) * scale / scale[:n, None] for name, values in results.items()
    }
    in_turn(list(timed.values()), _REPEATS)
    return timed, {name: float(np.max(each)) for name, each in differences.items()}


def _moved_end(dynamics: tx.Dynamics, x: Any, u: Any) -> Callable[[jax.Array], jax.Array]:
    """The tangent from the planned end to the end of the step that starts at x (+) d under u + du, h + dh."""
    n = dynamics.dimension

    def end(z: jax.Array) -> Any:
        inputs = dynamics._functions.prepare(0.0, dynamics.retract(x, z[:n]), {"T": u["T"] + z[n : n + 3]})
        control, length = dict(inputs.u), _STEP + z[n + 3]
        field = VectorField(dynamics, lambda _: control, dict(inputs.params))
        return _RK4.step(field, inputs.t, dict(inputs.x), length)

    planned = end(jnp.zeros(n + 4))
    return lambda z: dynamics.difference(planned, end(z))


def _linearised(way: str, what: str) -> float:
    timed = linearised()[0][way]
    return timed.compile_seconds if what == "compiling" else 1e6 * timed.seconds


LINEARISATION = Section(
    "linearisation",
    [
        Check("closed form against", _LOGARITHM, lambda: linearised()[1][_LOGARITHM], at_most(1e-12)),
        Check("closed form against", _DIFFERENCES, lambda: linearised()[1][_DIFFERENCES], at_most(1e-8)),
        *(
            Check(what, way, functools.partial(_linearised, way, what), between(unit=unit))
            for way in (_CLOSED, _LOGARITHM)
            for what, unit in (("compiling", "s"), ("an interval", "us"))
        ),
    ],
)

# ---- of a whole integration -----------------------------------------------------------------------------------------

#: Fixed and chosen steps; the tolerances are tight, since differences see how steps are chosen.
_WAYS: dict[str, dict[str, Any]] = {
    "RK4, 200 steps": {"steps": 200, "method": _RK4},
    "RK4, 20,000 steps": {"steps": 20_000, "method": _RK4},
    "TSIT5, 1e-11": {"rtol": 1e-11, "atol": 1e-11, "method": tx.RKMK(tx.tableaus.TSIT5)},
    "DOP853, 1e-11": {"rtol": 1e-11, "atol": 1e-11, "method": tx.RKMK(tx.tableaus.DOP853)},
}
#: Step of the differences, in rad, m, m/s, kg and s.
_H = 2e-3


@functools.cache
def _gradient(way: str) -> dict[str, float]:
    """The gradient of a weighted sum of the rocket scene's end by the start, in the tangent space, and the end time."""
    dynamics, options = ROCKET.dynamics, _WAYS[way]
    start = {name: jnp.asarray(value) for name, value in ROCKET.start.items()}
    n = dynamics.dimension
    weights, z = jnp.asarray(np.random.default_rng(0).normal(size=n)), jnp.zeros(n + 1)

    def function(z: jax.Array) -> jax.Array:
        x = dynamics.retract(start, z[:n])
        sol = tx.integrate(dynamics, x, t1=ROCKET.duration + z[n], u=ROCKET.u, params=ROCKET.params, **options)
        return weights @ dynamics.difference(start, {name: value[-1] for name, value in sol.xs.items()})

    run = jax.jit(function)
    gradient, solution = compiled(jax.grad(function), z), Timed(lambda: run(z))
    reverse, forward = gradient.result(), jax.jit(jax.jacfwd(function))(z)
    others = {"to forward mode": forward, "to differences": fourth_order(run, n + 1, _H)}
    size = float(jnp.abs(reverse).max())
    found = {name: float(jnp.abs(reverse - other).max()) / size for name, other in others.items()}
    agree(max(found.values()), 1e-6)
    in_turn([gradient, solution], _REPEATS)
    return found | {
        "compiling": gradient.compile_seconds,
        "gradient": 1e3 * gradient.seconds,
        "solution": 1e3 * solution.seconds,
        "memory": gradient.memory / 1e6,
    }


_COLUMNS = {
    "to forward mode": at_most(1e-8),
    "to differences": at_most(1e-8),
    "compiling": at_most(10.0, "s"),
    "gradient": between(unit="ms"),
    "solution": between(unit="ms"),
    "memory": between(unit="MB"),
}

GRADIENTS = Section(
    "gradients",
    [
        Check(way, name, functools.partial(lambda way, name: _gradient(way)[name], way, name), expected, slow=True)
        for way in _WAYS
        for name, expected in _COLUMNS.items()
    ],
    wide=True,
)
