"""Derivatives by programs of their own against finite differences, also of what has no such program."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import twistax as tx
from twistax.trajectory.smooth import Smooth


def turned(z: Any, pose: Any, weights: Any) -> Any:
    """A pose moved by a twist, seen from itself, and a product."""
    moved = tx.SE3.difference(pose, tx.SE3.retract(pose, z[:6]))
    return jnp.concatenate([moved * z[6], (weights["a"] * z[:3] ** 3) @ z[3:6] * jnp.ones(1)])


def iterated(z: Any, pose: Any, weights: Any) -> Any:
    """A loop whose length is not known has no program, and forward derivatives alone."""
    steps = jnp.int32(pose[3, 3]) + 2
    return jax.lax.fori_loop(0, steps, lambda _, a: jnp.sin(a) * weights["a"][0], z)


def centred(function: Any, z: np.ndarray, size: float) -> np.ndarray:
    """Extrapolated central differences, columns last."""
    near, far = (
        np.stack([(function(z + e * way) - function(z - e * way)) / (2.0 * e) for way in np.eye(len(z))], axis=-1)
        for e in (size, 2.0 * size)
    )
    return (4.0 * near - far) / 3.0


@functools.cache
def compiled() -> Any:
    """Value, slopes and bends of `turned`."""
    smooth = Smooth(turned, tx.XLA())
    return jax.jit(smooth.__call__), jax.jit(smooth.slopes), jax.jit(smooth.bends)


@pytest.mark.parametrize("offset", [0.0, 0.7])
def test_slopes_and_bends(offset: float) -> None:
    rng = np.random.default_rng(0)
    others = (np.asarray(tx.SE3.exp(rng.normal(size=6))), {"a": rng.normal(size=3)})
    value, slopes, bends = compiled()
    z, w = np.append(offset * rng.normal(size=6), 1.3), rng.normal(size=7)
    np.testing.assert_allclose(slopes(z, *others), centred(lambda z: value(z, *others), z, 1e-3), atol=1e-9)
    np.testing.assert_allclose(bends(w, z, *others), centred(lambda z: w @ slopes(z, *others), z, 1e-3), atol=1e-9)


def test_what_has_no_program_is_differentiated_by_jax() -> None:
    others = (np.eye(4), {"a": np.array([1.5, 0.0, 0.0])})
    z, w = jnp.array([0.3, -0.8]), jnp.array([1.0, 2.0])
    smooth = Smooth(iterated, tx.XLA())
    expected = Smooth(lambda z, *_: 1.5 * jnp.sin(1.5 * jnp.sin(1.5 * jnp.sin(z))), tx.XLA())
    np.testing.assert_allclose(smooth.slopes(z, *others), expected.slopes(z), rtol=1e-12)
    np.testing.assert_allclose(smooth.bends(w, z, *others), expected.bends(w, z), rtol=1e-12)
