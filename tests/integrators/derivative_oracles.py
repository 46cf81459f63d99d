"""Derivatives of a cost against each other and against differences."""

from collections.abc import Callable

import jax
import numpy as np


def check_derivatives(cost: Callable[[jax.Array], jax.Array], size: int) -> None:
    """Forward, reverse and finite differences of a cost of (size,) numbers, at two places at once, agree."""
    rng, step = np.random.default_rng(2), 1e-5
    places, direction = jax.numpy.asarray(rng.normal(size=(2, size))), jax.numpy.asarray(rng.normal(size=size))

    def along(z: jax.Array) -> tuple[jax.Array, jax.Array]:
        return jax.grad(cost)(z) @ direction, jax.jvp(cost, (z,), (direction,))[1]

    reverse, forward = jax.jit(jax.vmap(along))(places)
    cost = jax.jit(cost)
    numeric = [(cost(z + step * direction) - cost(z - step * direction)) / (2.0 * step) for z in places]
    np.testing.assert_allclose(reverse, forward, rtol=1e-12)
    np.testing.assert_allclose(reverse, numeric, rtol=1e-7)
