"""Loads from tables of numbers, as an operation of JAX."""

import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental.jet import jet

from twistax.scalar.primitives.table_load import Table, load


def test_a_load_under_every_transformation() -> None:
    """It has no slope: what has one is how its results are weighted."""
    table = Table([4.0, 5.0, 7.0, -1.0])

    def square(t: jax.Array) -> jax.Array:
        return t * load(table, t.astype(jnp.int32), t.dtype, 1)

    ts = jnp.array([0.5, 1.5, 2.0])
    np.testing.assert_array_equal(jax.vmap(square)(ts), [2.5, 10.5, -2.0])
    for slope in (jax.grad(square), jax.jacfwd(square), lambda t: jet(square, (t,), ((1.0, 0.0),))[1][0]):
        np.testing.assert_array_equal([slope(t) for t in ts], [5.0, 7.0, -1.0])
    assert Table([4.0, 5.0, 7.0, -1.0]) == table != Table([4.0, 5.0, 7.0, 1.0])
    assert load(table, jnp.int32(1), np.float32).dtype == np.float32
