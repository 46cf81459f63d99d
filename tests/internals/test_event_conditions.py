"""Conditions of events as functions."""

import functools
from typing import Any

import jax.numpy as jnp
import numpy as np

import twistax as tx
from twistax.integrators.events.conditions import _of_expression

WEIGHT = 9.81


SPIN = np.array([0.0, 0.0, 1.2])


g, V = tx.State("g", group=tx.SE3), tx.State("V", shape=(3,))


pull = tx.Parameter("pull", value=WEIGHT)


@functools.cache
def falling() -> tx.Dynamics:
    """A body that falls and turns about the vertical at a constant rate: heights and angles are known exactly."""
    rates = {g: tx.lie.twist(linear=g[:3, :3].T @ V, angular=SPIN), V: tx.Concat(0.0, 0.0, -pull)}
    return tx.compile(tx.System(rates=rates))


def start(height: Any = 5.0, speed: Any = 0.0) -> dict[str, Any]:
    return {"g": jnp.eye(4).at[2, 3].set(height), "V": jnp.zeros(3).at[2].set(speed)}


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
