"""The functions that are computed on both platforms: functions of batches, in single and double precision."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import twistax as tx

from ..speed.cases import CASES

#: Of the body, in kg m2 and kg.
_INERTIA = np.diag([2.0, 2.0, 2.0, 1.0, 2.0, 3.0])
#: Steps of a rollout; seconds that it takes.
STEPS, SECONDS = 1000, 1.0

Batch = Callable[..., Any]


@functools.cache
def _body(backend: Any) -> tx.Dynamics:
    """A rigid body without forces, its pose on SE(3)."""
    g, V, F = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,)), tx.Control("F", shape=(6,))
    rate = tx.linalg.Solve(_INERTIA, F - tx.lie.AdjointDual(V, _INERTIA @ V))
    return tx.compile(tx.System(rates={g: V, V: rate}), backend=backend)


@functools.cache
def _arm(backend: Any) -> tx.Dynamics:
    return tx.compile(CASES["aba-7"].system(), backend=backend)


def bodies(count: int, dtype: Any) -> dict[str, Any]:
    """Poses at the origin that turn, each in another way."""
    drawn = np.random.default_rng(1).uniform(-1.0, 1.0, (count, 6))
    return {"g": np.broadcast_to(np.eye(4, dtype=dtype), (count, 4, 4)), "V": drawn.astype(dtype)}


def joints(count: int, dtype: Any) -> tuple[Any, Any, Any]:
    """Angles, rates and torques."""
    drawn = np.random.default_rng(2).uniform(-1.0, 1.0, (3, count, 7))
    q, qd, tau = (5.0**k * values for k, values in zip((0, 0, 1), drawn, strict=True))
    return q.astype(dtype), qd.astype(dtype), tau.astype(dtype)


def rollout(backend: Any, **options: Any) -> Batch:
    """Where the bodies are after a second: 1,000 steps of RKMK4 if nothing else is said."""
    options = options or {"dt": SECONDS / STEPS}

    def one(x: Any) -> Any:
        return tx.integrate(_body(backend), x, t1=SECONDS, u={"F": jnp.zeros_like(x["V"])}, **options).xs

    return jax.vmap(one)


def adaptive(backend: Any, rows: int = 0) -> Batch:
    """The same by adaptive steps, to a relative tolerance of 1e-5; with so many rows saved on the way."""
    saved = {"save_at": np.linspace(0.0, SECONDS, rows)} if rows else {}
    return rollout(backend, rtol=1e-5, **saved)


def up_to_event(backend: Any) -> Batch:
    """Adaptive steps until a velocity changes its sign."""
    return rollout(backend, rtol=1e-5, event=tx.Event(tx.State("V", shape=(6,))[0]))


def accelerations(backend: Any) -> Batch:
    """Of the joints of the Panda."""

    def one(q: Any, qd: Any, tau: Any) -> Any:
        return _arm(backend)(0.0, {"qd": qd}, {"q": q}, {"third": tau})["qd"]

    return jax.vmap(one)


def calls(backend: Any, count: int = 100) -> Batch:
    """The accelerations, put in for the torques again and again in one program."""
    function = accelerations(backend)

    def run(q: Any, qd: Any, tau: Any) -> Any:
        for _ in range(count):
            tau = function(q, qd, tau)
        return tau

    return run


def slopes(backend: Any) -> Batch:
    """The derivatives of these by angles and rates."""

    def one(q: Any, qd: Any, tau: Any) -> Any:
        jacobian = _arm(backend).jacobian(0.0, {"qd": qd}, {"q": q}, {"third": tau}, wrt=("u", "x"))
        return jacobian["u"], jacobian["x"]

    return jax.vmap(one)


def walked(backend: Any) -> Batch:
    """A loop of JAX that is a kernel: an explicit step of a pendulum, again and again, every place kept."""

    @tx.fast(backend=backend)
    def walk(q: Any, qd: Any, tau: Any) -> Any:
        def step(state: Any, _: Any) -> Any:
            a, b = state
            b = b + 1e-2 * (tau[:3] - jnp.sin(a) * jnp.exp(-jnp.abs(b)))
            return (a + 1e-2 * b, b), a

        return jax.lax.scan(step, (q[:3], qd[:3]), None, length=300)

    return jax.vmap(walk)


def steps_in_scan(backend: Any) -> Batch:
    """Two hundred explicit steps of the Panda, a kernel in a loop of XLA's."""
    function = accelerations(backend)

    def run(q: Any, qd: Any, tau: Any) -> Any:
        def step(state: Any, _: Any) -> Any:
            q, qd = state
            return (q + 1e-4 * qd, qd + 1e-4 * function(q, qd, tau)), None

        return jax.lax.scan(step, (q, qd), None, length=200)[0]

    return run


def gradient(backend: Any) -> Batch:
    """Of a sum of squares of the accelerations, by angles and rates."""

    def loss(q: Any, qd: Any, tau: Any) -> Any:
        return jnp.sum(accelerations(backend)(q, qd, tau) ** 2)

    return jax.grad(loss, (0, 1))
