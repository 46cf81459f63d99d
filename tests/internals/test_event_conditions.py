"""Conditions of events as functions."""

import jax.numpy as jnp
import numpy as np
from test_events import WEIGHT, V, falling, g, start

import twistax as tx
from twistax.integrators.events.conditions import _of_expression


def test_all_numbers_that_a_condition_is_compared_with_are_data() -> None:
    """Conditions that differ in them alone are one function; its value is negative where they hold."""
    height, fall = g[2, 3], V[2]
    t, x, params = jnp.zeros(()), start(3.0, -2.0), {"pull": jnp.asarray(WEIGHT)}

    def condition(a: float, b: float) -> tx.Expr:
        return tx.Event(~tx.Any(height >= a, ~(b > fall))).condition

    found = [_of_expression(falling(), condition(a, b)) for a, b in ((4.0, -1.0), (0.0, 5.0), (2.0, -3.0))]
    assert len({function for function, _ in found}) == 1
    values = [float(function(t, x, {}, params, *levels)) for function, levels in found]
    np.testing.assert_allclose(values, [-1.0, 3.0, 1.0])  # of h < a and v < b: the largest of h - a and v - b
