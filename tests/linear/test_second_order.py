"""Value, Jacobian and weighted Hessian of an interval, against exact solutions and JAX's own second derivatives."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from trajectory_systems import quick_jit

import twistax as tx
from twistax.integrators import VectorField
from twistax.trajectory import discretize

RNG = np.random.default_rng(0)
N, M = 7, 2


def turning() -> tx.Dynamics:
    """An attitude that gravity turns, its rate, and a mass; one control is read by the time-varying rate alone."""
    R, w, m = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,)), tx.State("m")
    u, k = tx.Control("u"), tx.Control("k")
    inertia = np.array([1.0, 2.0, 3.0])
    torque = tx.linalg.Cross(R[2], [0.3, 0.1, 0.8]) * m + np.array([1.0, 0.0, 2.0]) * u * tx.Sin(tx.Time())
    rates = {R: w, w: (torque - tx.linalg.Cross(w, inertia * w)) / inertia, m: -k * m * u}
    return tx.compile(tx.System(rates=rates))


TURNING = turning()
X = {"R": np.asarray(tx.lie.so3.exp([0.4, -1.2, 2.0])), "w": np.array([0.5, -0.8, 1.1]), "m": np.array(1.3)}
U, WEIGHTS = {"u": np.array(0.7), "k": np.array(0.2)}, RNG.normal(size=N)


def apart(method: Any, substeps: int) -> Any:
    """weights . Log(x1^-1 end(z)) of z = [d, du, dh, dt] by the integrators' own steps."""

    def end(z: jax.Array) -> Any:
        u = {"u": U["u"] + z[N], "k": U["k"] + z[N + 1]}
        t, h = 0.2 + z[N + 3], (0.3 + z[N + 2]) / substeps
        x = {name: jnp.asarray(a) for name, a in TURNING.retract(X, z[:N]).items()}
        for i in range(substeps):
            x = method.step(VectorField(TURNING, lambda _: u, {}), t + i * h, x, h)
        return x

    return lambda z: WEIGHTS @ TURNING.difference(end(jnp.zeros_like(z)), end(z))


@pytest.mark.parametrize(
    ("method", "substeps"),
    [
        # One more stage is more of the same program: exact intervals and first derivatives are in other tests.
        pytest.param(tx.RKMK(tx.tableaus.HEUN), 1, marks=pytest.mark.slow),
        (tx.RKMK(tx.tableaus.EULER, tx.charts.Ambient()), 2),
        pytest.param(tx.RKMK(tx.tableaus.RK4), 1, marks=pytest.mark.slow),
        pytest.param(tx.CommutatorFree(tx.tableaus.CF4), 1, marks=pytest.mark.slow),
    ],
    ids=["RKMK2", "quaternions, two steps", "RKMK4", "commutator-free"],
)
def test_against_jax(method: Any, substeps: int) -> None:
    given = {"method": method, "substeps": substeps}
    found = discretize(TURNING, 0.2, X, U, 0.3, weights=WEIGHTS, **given)
    total, zero = apart(method, substeps), jnp.zeros(N + M + 2)
    slope, second = quick_jit(lambda z: (jax.grad(total)(z), jax.hessian(total)(z)))(zero)
    rows = np.column_stack([found.A, found.B, found.h_derivative, found.t_derivative])
    np.testing.assert_allclose(WEIGHTS @ rows, slope, atol=1e-12)
    np.testing.assert_allclose(found.hessian, second, rtol=0.0, atol=1e-11 * np.abs(second).max())
    assert np.array_equal(found.hessian, found.hessian.T)
    assert np.abs(second).max() > 0.1


def test_without_the_logarithm() -> None:
    """Value and first derivatives are those of the closed form. Other weights run the same program."""
    heun = tx.RKMK(tx.tableaus.HEUN)
    plain = discretize(TURNING, 0.2, X, U, 0.3, method=heun)
    made = []
    for scale in (1.0, -2.0):
        found = discretize(TURNING, 0.2, X, U, 0.3, method=heun, weights=scale * WEIGHTS)
        for name in ("A", "B", "h_derivative", "t_derivative"):
            np.testing.assert_allclose(getattr(found, name), getattr(plain, name), atol=1e-13)
        for name, value in plain.x1.items():
            np.testing.assert_allclose(found.x1[name], value, atol=1e-14)
        made.append(TURNING.functions.hessians.values())
    assert plain.hessian is None
    assert set(made[0]) == set(made[1])


def test_exact_intervals() -> None:
    """Euler's step of x' = x^2, and a constant rate of turn: Log(Exp(d) Exp(h du)) = d + h du + h d x du / 2 + ..."""
    y = tx.State("y")
    step = discretize(
        tx.compile(tx.System(rates={y: y * y})),
        0.0,
        {"y": 3.0},
        None,
        0.1,
        method=tx.RKMK(tx.tableaus.EULER),
        weights=[2.0],
    )
    np.testing.assert_allclose(step.hessian, 2.0 * np.array([[0.2, 6.0, 0.0], [6.0, 0.0, 0.0], [0.0, 0.0, 0.0]]))
    R, w = tx.State("R", group=tx.SO3), tx.Control("w", shape=(3,))
    weights = np.array([1.0, 2.0, -0.5])
    euler = tx.RKMK(tx.tableaus.EULER)
    turned = tx.compile(tx.System(rates={R: w}))
    step = discretize(turned, 0.0, {"R": X["R"]}, {"w": np.zeros(3)}, 0.4, method=euler, weights=weights)
    across = np.array([[0.2 * np.cross(d, du) @ weights for du in np.eye(3)] for d in np.eye(3)])
    expected = np.zeros((8, 8))
    expected[:3, 3:6], expected[3:6, :3] = across, across.T
    expected[3:6, 6] = expected[6, 3:6] = weights  # h du
    np.testing.assert_allclose(step.hessian, expected, atol=1e-13)


def test_wrong_weights() -> None:
    with pytest.raises(tx.InputError, match=r"weights expects shape \(7,\), one number for each tangent.*got \(3,\)"):
        discretize(TURNING, 0.2, X, U, 0.3, weights=np.ones(3))
    with pytest.raises(tx.InputError, match=r"weights expects finite numbers, got .*nan"):
        discretize(TURNING, 0.2, X, U, 0.3, weights=np.full(7, np.nan))
