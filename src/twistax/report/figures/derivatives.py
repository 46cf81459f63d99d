"""Accuracy and cost of derivatives: of a step, and of an integration."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import twistax as tx

from ...integrators import VectorField
from ...scenes import Scene
from ...scenes.powered_descent import Lander, Start, initial, system
from ...scenes.rocket import ROCKET
from ...trajectory import discretize
from ...trajectory.transcription.vectors import declared_scales
from ..harness.expected import at_most, between
from ..harness.measurement import Section, quick, table
from ..harness.timing import Repeats, Timed, agree, compiled, in_turn

_REPEATS, _RK4 = Repeats(5, 5), tx.RKMK(tx.tableaus.RK4)


def fourth_order(run: Callable[[jax.Array], jax.Array], size: int, h: float) -> jax.Array:
    """The gradient at zero by central differences of fourth order."""
    four = [8.0 * (run(e) - run(-e)) - (run(2.0 * e) - run(-2.0 * e)) for e in h * jnp.eye(size)]
    return jnp.stack(four) / (12.0 * h)


def weighted_end(scene: Scene, moved: jax.Array, **options: Any) -> jax.Array:
    """A weighted sum of the end of a scene whose start is moved by a tangent."""
    dynamics, start = scene.dynamics, {name: jnp.asarray(value) for name, value in scene.start.items()}
    weights = jnp.asarray(np.random.default_rng(0).normal(size=dynamics.dimension))
    options = {"u": scene.u, "params": scene.params} | options
    sol = tx.integrate(dynamics, dynamics.retract(start, moved), **options)
    return weights @ dynamics.difference(start, {name: value[-1] for name, value in sol.xs.items()})


_STEP, _BATCH = 0.5, 24
_CLOSED, _LOGARITHM, _DIFFERENCES = "closed form", "jacfwd of the logarithm", "Richardson differences"


@functools.cache
def linearised() -> tuple[dict[str, Timed], dict[str, float]]:
    """A, B and dx/dh of a batch of intervals by three programs, timed, and how far two are from the closed form.

    A rocket stage: a pose, a body twist and a mass under thrust, 0.5 s. Differences are of the largest entry, with the
    unknowns in their scales. Needs JAX's x64 switch.
    """
    dynamics, rng, vehicle = tx.compile(system()), np.random.default_rng(0), Lander()
    scale = np.append(declared_scales((*dynamics.states, *dynamics.controls)), _STEP)
    n = dynamics.dimension
    # States around the start of the descent and thrusts around 60 %, leading axis the batch.
    offsets = 0.3 * rng.normal(size=(_BATCH, n)) * scale[:n]
    xs = jax.jit(jax.vmap(dynamics.retract, (None, 0)))(initial(Start(), vehicle), offsets)
    thrusts = vehicle.max_thrust * (np.array([0.0, 0.0, 0.6]) + 0.1 * rng.normal(size=(_BATCH, 3)))

    def end(x: Any, u: Any, z: jax.Array) -> Any:
        """The end of the step that starts at x (+) d under u + du, h + dh."""
        field = VectorField(dynamics, lambda _: {"T": u["T"] + z[n : n + 3]}, {})
        return _RK4.step(field, jnp.zeros(()), dynamics.retract(x, z[:n]), _STEP + z[n + 3])

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
    forms = {_CLOSED: closed, _LOGARITHM: by_logarithm, _DIFFERENCES: by_differences}
    arguments = xs, {"T": jnp.asarray(thrusts)}
    timed = {name: compiled(jax.vmap(form), *arguments, evaluations=_BATCH) for name, form in forms.items()}
    results = {name: np.asarray(it.result()) for name, it in timed.items()}
    in_turn([timed[_CLOSED], timed[_LOGARITHM]], _REPEATS)
    errors = {name: np.abs(results[_CLOSED] - it) * scale / scale[:n, None] for name, it in results.items()}
    return timed, {name: float(np.max(error)) for name, error in errors.items()}


LINEARISATION: Section = [
    quick("closed form against", _LOGARITHM, at_most(1e-12), lambda: linearised()[1][_LOGARITHM]),
    quick("closed form against", _DIFFERENCES, at_most(1e-8), lambda: linearised()[1][_DIFFERENCES]),
    *(
        quick(what, name, between(unit=unit), lambda name, read: read(linearised()[0][name]), name, read)
        for name in (_CLOSED, _LOGARITHM)
        for what, unit, read in (
            ("compiling", "s", lambda timed: timed.compile_seconds),
            ("an interval", "us", lambda timed: 1e6 * timed.seconds),
        )
    ),
]

#: Fixed and chosen steps; the tolerances are tight, since differences see how steps are chosen.
_STEPS: dict[str, dict[str, Any]] = {
    "RK4, 200 steps": {"steps": 200, "method": _RK4},
    "RK4, 20,000 steps": {"steps": 20_000, "method": _RK4},
    "TSIT5, 1e-11": {"rtol": 1e-11, "atol": 1e-11, "method": tx.RKMK(tx.tableaus.TSIT5)},
    "DOP853, 1e-11": {"rtol": 1e-11, "atol": 1e-11, "method": tx.RKMK(tx.tableaus.DOP853)},
}
#: Step of the differences, in rad, m, m/s, kg and s.
_H = 2e-3


@functools.cache
def _gradient(steps: str) -> dict[str, float]:
    """The gradient of a weighted sum of the rocket scene's end by the start, in the tangent space, and the end time."""
    n = ROCKET.dynamics.dimension
    z = jnp.zeros(n + 1)
    function = lambda z: weighted_end(ROCKET, z[:n], t1=ROCKET.duration + z[n], **_STEPS[steps])  # noqa: E731
    run = jax.jit(function)
    gradient, solution = compiled(jax.grad(function), z), Timed(lambda: run(z))
    reverse, forward = gradient.result(), jax.jit(jax.jacfwd(function))(z)
    references = {"to forward mode": forward, "to differences": fourth_order(run, n + 1, _H)}
    size = float(jnp.abs(reverse).max())
    numbers = {name: float(jnp.abs(reverse - reference).max()) / size for name, reference in references.items()}
    agree(max(numbers.values()), 1e-6)
    in_turn([gradient, solution], _REPEATS)
    numbers |= {"compiling": gradient.compile_seconds, "memory": gradient.memory / 1e6}
    return numbers | {"gradient": 1e3 * gradient.seconds, "solution": 1e3 * solution.seconds}


_COLUMNS = {
    "to forward mode": at_most(1e-8),
    "to differences": at_most(1e-8),
    "compiling": at_most(10.0, "s"),
    "gradient": between(unit="ms"),
    "solution": between(unit="ms"),
    "memory": between(unit="MB"),
}
_column = lambda name: lambda steps: _gradient(steps)[name]  # noqa: E731

GRADIENTS: Section = table(
    {steps: steps for steps in _STEPS}, {name: (expected, _column(name)) for name, expected in _COLUMNS.items()}
)
