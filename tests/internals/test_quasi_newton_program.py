"""Updates of the Hessian need no second derivative."""

from typing import Any

import jax
import numpy as np
import pytest
from test_hessians import pendulum

import twistax as tx
from twistax.expr.operations.elementwise import ElementwiseFunction
from twistax.trajectory import Problem, QuasiNewton


def test_quasi_newton_needs_no_second_derivative() -> None:
    @jax.custom_jvp
    def lift(x: jax.Array) -> jax.Array:
        return jax.pure_callback(lambda x: np.sin(x), x, x, vmap_method="sequential")

    @lift.defjvp
    def _slope(primals: Any, tangents: Any) -> Any:
        (x,), (dx,) = primals, tangents
        slope = jax.pure_callback(lambda x: np.cos(x), x, x, vmap_method="sequential")
        return lift(x), slope * dx

    class Lift(ElementwiseFunction):
        """The sine, by a function without second derivatives."""

        function = staticmethod(lift)

    angle, rate, torque = tx.State("angle"), tx.State("rate"), tx.Control("torque", min=-8.0, max=8.0)
    dynamics = tx.compile(tx.System(rates={angle: rate, rate: torque - 9.81 * Lift(angle) - 0.1 * rate}))
    ends: Any = {"initial": {angle: 0.0, rate: 0.0}, "final": {angle: np.pi, rate: 0.0}}
    found = Problem(
        dynamics, tx.Minimize(running=torque**2), nodes=21, final_time=2.0, hessian=QuasiNewton(), **ends
    ).solve()
    assert found.solved
    assert found.cost == pytest.approx(pendulum(swing=True).solve().cost, rel=1e-6)
