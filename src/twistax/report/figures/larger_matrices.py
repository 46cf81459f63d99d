"""Matrices in loops by `tx.fast` compared with JAX, and the gradient through a learned rate compared with diffrax."""

from collections.abc import Callable
from functools import partial
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import twistax as tx

from ..harness.expected import at_most
from ..harness.measurement import Section, quick
from ..harness.timing import Race, Repeats, Timed, compiled

_REPEATS, _CALLS = Repeats(15, 5), 100


def riccati(P: jax.Array, A: jax.Array, B: jax.Array) -> jax.Array:
    """The cost to go one step before, of a linear-quadratic regulator with unit weights; by Cholesky's factor."""
    factor = jax.scipy.linalg.cho_factor(jnp.eye(B.shape[1]) + B.T @ P @ B)
    return jnp.eye(len(P)) + A.T @ P @ (A - B @ jax.scipy.linalg.cho_solve(factor, B.T @ P @ A))


def by_a_solve(P: jax.Array, A: jax.Array, B: jax.Array) -> jax.Array:
    """The same, $1 + A^T P (1 + B B^T P)^-1 A$."""
    return jnp.eye(len(P)) + A.T @ P @ jnp.linalg.solve(jnp.eye(len(P)) + B @ B.T @ P, A)


def placements(q: jax.Array) -> jax.Array:
    """The poses (n, 4, 4) of the links of a chain whose axes are z and x in turn."""
    pose, links = jnp.eye(4), []
    for i in range(len(q)):
        c, s, one, zero = jnp.cos(q[i]), jnp.sin(q[i]), jnp.ones(()), jnp.zeros(())
        turn = (
            [[c, -s, zero], [s, c, zero], [zero, zero, one]]
            if i % 2
            else [[one, zero, zero], [zero, c, -s], [zero, s, c]]
        )
        top = jnp.concatenate([jnp.array(turn), jnp.array([[0.1], [0.0], [0.2]])], axis=1)
        pose = pose @ jnp.concatenate([top, jnp.array([[0.0, 0.0, 0.0, 1.0]])])
        links.append(pose)
    return jnp.stack(links)


def _beside_jax(function: Callable[..., Any], *arguments: Any) -> Race:
    """A function by both. A result is that of the last of some calls."""

    def programs() -> dict[str, Timed]:
        arrays = [jnp.asarray(a) for a in arguments]
        forms = {"JAX": function, "tx.fast": tx.fast(function)}
        return {name: compiled(form, *arrays, calls=_CALLS) for name, form in forms.items()}

    return Race(programs, 1e-9, _REPEATS)


def _in_a_scan(P: jax.Array, A: jax.Array, B: jax.Array, step: Callable[..., jax.Array]) -> jax.Array:
    """The cost `_CALLS` steps before, as a regulator's recursion is written."""
    return jax.lax.scan(lambda P, _: (step(P, A, B), None), P, None, length=_CALLS)[0]


def _recursion(step: Callable[..., jax.Array], *arguments: Any) -> Race:
    """A scan of steps by both."""

    def programs() -> dict[str, Timed]:
        forms = {"JAX": step, "tx.fast": tx.fast(step)}
        return {
            name: compiled(partial(_in_a_scan, step=form), *map(jnp.asarray, arguments), evaluations=_CALLS)
            for name, form in forms.items()
        }

    return Race(programs, 1e-9, _REPEATS)


def learned() -> dict[str, Timed]:
    """The gradient of the end of 20 steps of $x' = -x + net(x)$ by the weights of a network 4-64-64-4."""
    net = eqx.nn.MLP(4, 4, 64, 2, key=jax.random.key(0))
    arrays, rest = eqx.partition(net, eqx.is_inexact_array)
    x, weights = tx.State("x", shape=(4,)), tx.ParameterTree("net", net)
    dynamics = tx.compile(tx.System(rates={x: -x + tx.Function(lambda m, y: m(y), (4,))(weights, x)}))
    start, method = np.array([1.0, -0.5, 0.3, 0.2]), tx.RKMK(tx.tableaus.TSIT5)

    def ours(arrays: Any) -> jax.Array:
        params = weights.values(eqx.combine(arrays, rest))
        run = tx.integrate(dynamics, {"x": start}, t1=1.0, dt=0.05, method=method, params=params)
        return jnp.sum(run.last["x"] ** 2)

    def theirs(arrays: Any) -> jax.Array:
        net = eqx.combine(arrays, rest)
        term = diffrax.ODETerm(lambda t, y, args: -y + net(y))
        run = diffrax.diffeqsolve(term, diffrax.Tsit5(), 0.0, 1.0, 0.05, jnp.asarray(start))
        return jnp.sum(run.ys[-1] ** 2)

    return {name: compiled(jax.grad(f), arrays, calls=20) for name, f in (("diffrax", theirs), ("tx.integrate", ours))}


def _flat(gradient: Any) -> np.ndarray:
    return np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(gradient)])


_RANDOM = np.random.default_rng(0)
_SYSTEM = np.eye(12), 0.9 * np.eye(12) + 0.05 * _RANDOM.normal(size=(12, 12)), _RANDOM.normal(size=(12, 4))
_RACES = {
    "Riccati step of 12x12": _beside_jax(riccati, *_SYSTEM),
    "Riccati step with a solve of 12x12": _beside_jax(by_a_solve, *_SYSTEM),
    "Riccati steps of 12x12 in a scan": _recursion(riccati, *_SYSTEM),
    "Riccati steps with a solve of 12x12 in a scan": _recursion(by_a_solve, *_SYSTEM),
    "all placements of a chain of 35 joints": _beside_jax(placements, _RANDOM.normal(size=35)),
}
_LEARNED = Race(learned, 1e-7, _REPEATS, _flat)

LARGER: Section = [
    *(
        quick(f"{what}: time over JAX", "tx.fast", at_most(0.3), race.ratio, "tx.fast", "JAX")
        for what, race in _RACES.items()
    ),
    quick(
        "network 4-64-64-4 as a rate, gradient through 20 steps: time over diffrax",
        "tx.integrate",
        at_most(0.5),
        _LEARNED.ratio,
        "tx.integrate",
        "diffrax",
    ),
]
