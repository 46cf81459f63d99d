"""The batch smoother against dense least squares by SciPy, and the smoother of a fixed lag against runs that end."""

from itertools import pairwise
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm, logm
from scipy.optimize import least_squares

import twistax as tx
from twistax.estimation import BatchSmoother, CauchyLoss, ErrorStateKalman, FixedLagSmoother, HuberLoss, RobustLoss

TIMES = 0.4 * np.arange(8)
x = tx.State("x", shape=(2,))
PENDULUM = tx.compile(tx.System(rates={x: tx.Concat(x[1], tx.Noise("w", density=0.3) - 4.0 * np.sin(x[0]))}))
HEIGHT = tx.Measurement("height", np.sin(x[0]), covariance=0.01)
RECORDS: Any = {"height": (TIMES, np.zeros(8))}
START, P0 = {"x": np.array([1.2, 0.0])}, np.array([0.3, 0.2])


def rate(y: np.ndarray) -> np.ndarray:
    return np.array([y[1], -4.0 * np.sin(y[0])])


def step(y: np.ndarray, h: float) -> np.ndarray:
    """RK4."""
    a = rate(y)
    b = rate(y + 0.5 * h * a)
    c = rate(y + 0.5 * h * b)
    return y + h / 6.0 * (a + 2.0 * b + 2.0 * c + rate(y + h * c))


def noise(y: np.ndarray, h: float) -> np.ndarray:
    """The covariance over a step, by quadrature, with the derivative in the middle."""
    middle = 0.5 * (y + step(y, h))
    F = np.array([[0.0, 1.0], [-4.0 * np.cos(middle[0]), 0.0]])
    nodes, weights = np.polynomial.legendre.leggauss(12)
    columns = np.array([expm(F * 0.5 * h * (node + 1.0))[:, 1] for node in nodes])
    return 0.09 * np.einsum("s,si,sj->ij", 0.5 * h * weights, columns, columns)


def measured(seed: int = 0) -> np.ndarray:
    rng, y, values = np.random.default_rng(seed), np.array([1.5, 0.1]), []
    for _ in TIMES:
        values.append(np.sin(y[0]) + 0.1 * rng.normal())
        y = step(y, 0.4) + np.linalg.cholesky(noise(y, 0.4)) @ rng.normal(size=2)
    return np.array(values)


#: rho(s) of width one.
HUBER = lambda s: np.where(s <= 1.0, s, 2.0 * np.sqrt(s) - 1.0)  # noqa: E731
CAUCHY = np.log1p


def most_probable(values: np.ndarray, states: np.ndarray, rho: Any) -> np.ndarray:
    """By dense least squares, with the covariances at the states, whose derivatives Gauss-Newton leaves out."""
    roots = [np.linalg.inv(np.linalg.cholesky(noise(y, 0.4))) for y in states[:-1]]

    def residuals(flat: np.ndarray) -> np.ndarray:
        ys = flat.reshape(-1, 2)
        parts = [(ys[0] - START["x"]) / np.sqrt(P0)]
        parts += [root @ (b - step(a, 0.4)) for root, a, b in zip(roots, ys, ys[1:])]
        r = (values - np.sin(ys[:, 0])) / 0.1
        if rho is not None:
            r = np.sign(r) * np.sqrt(rho(r * r))
        return np.concatenate([*parts, np.where(np.isfinite(values), r, 0.0)])

    start = states.ravel() + 1e-3
    return least_squares(residuals, start, xtol=1e-15, ftol=1e-15, gtol=1e-13).x.reshape(-1, 2)


@pytest.mark.parametrize(("loss", "rho"), [(None, None), (HuberLoss(1.0), HUBER), (CauchyLoss(1.0), CAUCHY)])
def test_the_states_are_those_of_dense_least_squares(loss: RobustLoss | None, rho: Any) -> None:
    values = measured()
    values[3] += 0.0 if loss is None else 1.0  # an outlier of ten deviations
    values[5] = np.nan
    losses = {} if loss is None else {"height": loss}
    estimate = BatchSmoother(PENDULUM, [HEIGHT], losses=losses, tolerance=1e-9).run(
        {"height": (TIMES, values)}, START, P0
    )
    states = np.asarray(estimate.xs["x"])
    np.testing.assert_allclose(states, most_probable(values, states, rho), atol=2e-7)
    assert estimate.result == "successful"
    np.testing.assert_array_equal(estimate.weights["height"] == 0.0, np.isnan(values))
    assert loss is None or estimate.weights["height"][3] < 0.3


def test_a_linear_problem_takes_one_step_to_the_smoother_of_the_filter() -> None:
    """With a state without noise, from a guess that is far away."""
    c, y = tx.State("c"), tx.State("y", shape=(2,))
    dynamics = tx.compile(tx.System(rates={y: tx.Concat(y[1], tx.Noise("w", density=0.7) + c), c: 0.0}))
    measurement = tx.Measurement("z", y[0], covariance=0.09)
    records: Any = {"z": (TIMES, np.sin(3.0 * TIMES))}
    start, P = {"y": np.zeros(2), "c": 0.5}, [1.0, 2.0, 0.3]
    exact = ErrorStateKalman(dynamics, [measurement]).run(records, start, P).smooth()
    guess = {"y": np.ones((8, 2)), "c": np.full(8, -3.0)}
    estimate = BatchSmoother(dynamics, [measurement]).run(records, start, P, guess=guess)
    for name in ("y", "c"):
        np.testing.assert_allclose(estimate.xs[name], exact.xs[name], atol=1e-11)
    np.testing.assert_allclose(estimate.P, exact.P, atol=1e-11)
    assert int(estimate.iterations) <= 3


@pytest.mark.parametrize(("loss", "cost"), [(HuberLoss(2.0), 8.0), (CauchyLoss(2.0), 4.0 * np.log(3.25))])
def test_weights_are_the_derivatives_of_losses(loss: RobustLoss, cost: float) -> None:
    """At three deviations, with a width of two; near zero both are squares."""
    s, h = jnp.asarray(9.0), 1e-5
    np.testing.assert_allclose(loss.cost(s), cost, rtol=1e-12)
    np.testing.assert_allclose(loss.weight(s), (loss.cost(s + h) - loss.cost(s - h)) / (2.0 * h), rtol=1e-8)
    np.testing.assert_allclose(loss.cost(jnp.asarray(1e-6)), 1e-6, rtol=1e-6)


def hat(w: np.ndarray) -> np.ndarray:
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


def log(R: np.ndarray) -> np.ndarray:
    W = np.real(logm(R))
    return np.array([W[2, 1], W[0, 2], W[1, 0]])


def test_the_gradient_of_the_posterior_vanishes_on_a_group() -> None:
    """Attitudes from a vector and a rate; the density in NumPy, its gradient by differences."""
    q = tx.State("q", group=tx.SO3)
    rate, field = np.array([0.4, -0.7, 1.1]), np.array([0.3, -0.2, 0.9])
    density = np.array([0.2, 0.5, 0.9])
    dynamics = tx.compile(tx.System(rates={q: rate + tx.Noise("n", shape=(3,), density=density)}))
    ts, rng = 0.5 * np.arange(4), np.random.default_rng(1)
    values = np.stack([expm(hat(-rate * t)) @ field for t in ts]) + 0.1 * rng.normal(size=(4, 3))
    start = {"q": expm(hat(np.array([0.8, -0.5, 0.3])))}
    smoother = BatchSmoother(dynamics, [tx.Measurement("field", q.T @ field, covariance=0.01)], tolerance=1e-10)
    estimate = smoother.run({"field": (ts, values)}, start, 0.5)
    turn = expm(hat(rate * 0.5))
    nodes, weights = np.polynomial.legendre.leggauss(12)
    turns = [expm(-hat(rate) * 0.25 * (node + 1.0)) for node in nodes]
    Q = sum(0.25 * weight * back @ np.diag(density**2) @ back.T for weight, back in zip(weights, turns))

    def cost(d: np.ndarray) -> float:
        R = [r @ expm(hat(e)) for r, e in zip(np.asarray(estimate.xs["q"]), d.reshape(4, 3))]
        total = log(start["q"].T @ R[0]) @ log(start["q"].T @ R[0]) / 0.5
        misses = [log((a @ turn).T @ b) for a, b in pairwise(R)]
        total += sum(e @ np.linalg.solve(Q, e) for e in misses)
        return 0.5 * float(total + sum(np.sum((z - r.T @ field) ** 2) for z, r in zip(values, R)) / 0.01)

    np.testing.assert_allclose(estimate.cost, cost(np.zeros(12)), rtol=1e-9)
    h = 1e-5
    slope = [(cost(h * unit) - cost(-h * unit)) / (2.0 * h) for unit in np.eye(12)]
    np.testing.assert_allclose(slope, np.zeros(12), atol=1e-6)


def test_what_does_not_converge_is_named() -> None:
    smoother = BatchSmoother(PENDULUM, [HEIGHT], max_iterations=1)
    with pytest.raises(tx.EstimationError, match="not converged after 1 steps"):
        smoother.run({"height": (TIMES, measured())}, START, P0)


def test_a_fixed_lag_is_a_run_that_ends_so_much_later() -> None:
    kalman, values = ErrorStateKalman(PENDULUM, [HEIGHT]), measured()
    run = kalman.run({"height": (TIMES, values)}, START, P0)
    lagged = run.smooth(FixedLagSmoother(3))
    for k in range(8):
        last = min(k + 4, 8)
        short = kalman.run({"height": (TIMES[:last], values[:last])}, START, P0).smooth()
        np.testing.assert_allclose(lagged.xs["x"][k], short.xs["x"][k], atol=1e-12)
        np.testing.assert_allclose(lagged.P[k], short.P[k], atol=1e-12)
    np.testing.assert_allclose(run.smooth(FixedLagSmoother(20)).P, run.smooth().P, atol=1e-14)


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: BatchSmoother(PENDULUM, [HEIGHT], losses={"y": HuberLoss()}), tx.ModelError, "losses names 'y'"),
        (lambda: HuberLoss(0.0), tx.ModelError, "width"),
        (lambda: FixedLagSmoother(0), tx.InputError, "lag"),
        (
            lambda: BatchSmoother(PENDULUM, [HEIGHT]).run(RECORDS, START, P0, guess={}),
            tx.InputError,
            "guess needs the state 'x'",
        ),
        (
            lambda: BatchSmoother(PENDULUM, [HEIGHT]).run(
                {"height": (TIMES, TIMES)}, START, P0, guess={"x": np.ones(2)}
            ),
            tx.ShapeError,
            r"\(8, 2\)",
        ),
    ],
)
def test_bad_arguments_are_refused(call: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        call()
