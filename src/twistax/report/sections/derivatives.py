"""Derivatives of steps and of whole integrations: how well they agree with other ways to them, and what they cost."""

from __future__ import annotations

import functools
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
from .stiff import fourth_order

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

    def end(x: Any, u: Any, z: jax.Array) -> Any:
        """The end of the step that starts at x (+) d under u + du, h + dh."""
        inputs = dynamics._functions.prepare(0.0, dynamics.retract(x, z[:n]), {"T": u["T"] + z[n : n + 3]})
        control, length = dict(inputs.u), _STEP + z[n + 3]
        field = VectorField(dynamics, lambda _: control, dict(inputs.params))
        return _RK4.step(field, inputs.t, dict(inputs.x), length)

    def moved(x: Any, u: Any, z: jax.Array) -> jax.Array:
        """The tangent from the planned end to that one."""
        return dynamics.difference(end(x, u, jnp.zeros(n + 4)), end(x, u, z))

    def closed(x: Any, u: Any) -> jax.Array:
        step = discretize(dynamics, 0.0, x, u, _STEP)
        return jnp.concatenate([step.A, step.B, step.h_derivative[:, None]], axis=1)

    def by_differences(x: Any, u: Any) -> jax.Array:
        ends = jax.vmap(functools.partial(moved, x, u))

        def central(size: float) -> jax.Array:
            steps = size * jnp.diag(jnp.asarray(scale))
            return (ends(steps) - ends(-steps)).T / (2.0 * size * scale[None, :])

        return (4.0 * central(5e-4) - central(1e-3)) / 3.0

    by_logarithm = lambda x, u: jax.jacfwd(functools.partial(moved, x, u))(jnp.zeros(n + 4))  # noqa: E731
    ways = {_CLOSED: closed, _LOGARITHM: by_logarithm, _DIFFERENCES: by_differences}
    arguments = xs, {"T": jnp.asarray(thrusts)}
    timed = {name: compiled(jax.vmap(way), *arguments, evaluations=_BATCH) for name, way in ways.items()}
    results = {name: np.asarray(each.result()) for name, each in timed.items()}
    in_turn([timed[_CLOSED], timed[_LOGARITHM]], _REPEATS)
    off = {name: np.abs(results[_CLOSED] - each) * scale / scale[:n, None] for name, each in results.items()}
    return timed, {name: float(np.max(each)) for name, each in off.items()}


LINEARISATION: Section = [
    Check("closed form against", _LOGARITHM, at_most(1e-12), lambda: linearised()[1][_LOGARITHM]),
    Check("closed form against", _DIFFERENCES, at_most(1e-8), lambda: linearised()[1][_DIFFERENCES]),
    *(
        Check(what, way, between(unit=unit), lambda way, read: read(linearised()[0][way]), way, read)
        for way in (_CLOSED, _LOGARITHM)
        for what, unit, read in (
            ("compiling", "s", lambda timed: timed.compile_seconds),
            ("an interval", "us", lambda timed: 1e6 * timed.seconds),
        )
    ),
]

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
    found |= {"compiling": gradient.compile_seconds, "memory": gradient.memory / 1e6}
    return found | {"gradient": 1e3 * gradient.seconds, "solution": 1e3 * solution.seconds}


_COLUMNS = {
    "to forward mode": at_most(1e-8),
    "to differences": at_most(1e-8),
    "compiling": at_most(10.0, "s"),
    "gradient": between(unit="ms"),
    "solution": between(unit="ms"),
    "memory": between(unit="MB"),
}

GRADIENTS: Section = [
    Check(way, name, expected, lambda way, name: _gradient(way)[name], way, name, slow=True)
    for way in _WAYS
    for name, expected in _COLUMNS.items()
]
