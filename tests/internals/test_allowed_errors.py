"""What tolerances allow."""

import jax.numpy as jnp
import numpy as np

import twistax as tx
from twistax.integrators.options import tolerances_of


def test_tolerances_never_fall_below_round_off() -> None:
    x = tx.State("x", scale=1e-9)
    dynamics = tx.compile(tx.System(rates={x: x}))
    allowed = tolerances_of(dynamics, 1e-12, 0.0, np.float64)._allowed_part("x", jnp.array([1e3]))
    np.testing.assert_allclose(allowed, 10.0 * np.finfo(float).eps * 1e3)
