"""Errors of the bridge to diffrax, in matrices and in coordinates."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from integrator_bodies import start as body_start
from test_lie_solver import tumbling

import twistax as tx
from twistax.integrators.diffrax_bridge.frame import ChartedSystem


@pytest.mark.parametrize("order", [tx.LINEAR_FIRST, tx.ANGULAR_FIRST], ids=repr)
def test_errors_are_read_back_as_the_deviations_they_were(order: tx.Order) -> None:
    frame = ChartedSystem(tx.compile(tumbling(order)), tx.charts.Exponential())
    x = {"g": tx.pose(position=[1.0, 2.0, 3.0], euler=[0.3, -0.4, 0.5]), "V": jnp.asarray(body_start()["V"])}
    end, e = frame.local.enter(x), frame.packed(x)[1](1e-3 * jnp.arange(1.0, 13.0))
    found, wanted = frame.deviations(x, frame.errors(x, end, e)), frame.local.deviation(e, end)
    assert jax.tree.structure(found) == jax.tree.structure(wanted)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(wanted)):
        np.testing.assert_allclose(one, other, atol=1e-15)
