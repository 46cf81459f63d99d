"""The filter with square roots: the numbers of the error-state filter, and single precision where that one fails."""

import jax
import numpy as np

import twistax as tx
from twistax.estimation import ErrorStateKalman, SquareRootKalman

FIELD = np.array([0.3, -0.2, 0.9])
TIMES = np.array([0.1, 0.4, 0.9])


def test_the_numbers_are_those_of_the_error_state_filter() -> None:
    """With a state that is known, a measurement that is missing and one that is gated."""
    q, b, c = tx.State("q", group=tx.SO3), tx.State("b", shape=(3,)), tx.State("c")
    rates = {q: np.array([0.4, -0.7, 1.1]) - b + tx.Noise("n", shape=(3,), density=0.1), b: np.zeros(3), c: 0.0}
    dynamics, field = tx.compile(tx.System(rates=rates)), tx.Measurement("field", q.T @ FIELD + c, covariance=0.01)
    values = np.stack([FIELD, np.full(3, np.nan), 9.0 * FIELD])
    start = {"q": np.asarray(tx.SO3.exp(np.array([0.5, 0.2, -0.8]))), "b": np.zeros(3), "c": 0.1}
    P0 = np.diag([0.3, 0.2, 0.1, 0.01, 0.01, 0.01, 0.0])
    roots, squares = (
        kind(dynamics, [field], gate=0.999).run({"field": (TIMES, values)}, start, P0, t0=0.0)
        for kind in (SquareRootKalman, ErrorStateKalman)
    )
    np.testing.assert_array_equal(roots.innovations["field"].used, [True, False, False])
    for one, other in zip(jax.tree.leaves(roots), jax.tree.leaves(squares), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-12)


def test_single_precision_reaches_deviations_that_are_far_apart() -> None:
    """A constant of deviation 30, measured to 1e-3 along two directions: 4.5 digits, and 9 in squares."""
    x = tx.State("x", shape=(2,))
    dynamics = tx.compile(tx.System(rates={x: np.zeros(2)}))
    measurements = [tx.Measurement(name, x @ a, covariance=1e-6) for name, a in (("a", [1.0, 1.0]), ("b", [1.0, 0.9]))]
    start = {"x": np.zeros(2, np.float32)}
    rows = np.array([[1.0, 1.0], [1.0, 0.9]])
    exact = np.linalg.inv(1e-3 * np.eye(2) + rows.T @ rows / 1e-6)

    def last(kind: type[ErrorStateKalman]) -> np.ndarray:
        P, state = np.float32(1e3) * np.eye(2, dtype=np.float32), start
        run = kind(dynamics, measurements).run({"a": ([0.0], [0.0]), "b": ([1.0], [0.0])}, state, P)
        return np.asarray(run.P[-1])

    np.testing.assert_allclose(last(SquareRootKalman), exact, rtol=1e-2)
    try:
        P = last(ErrorStateKalman)
    except tx.EstimationError:
        return
    assert np.abs(P / exact - 1.0).max() > 0.1


def test_the_likelihood_has_a_gradient() -> None:
    x = tx.State("x")
    dynamics = tx.compile(tx.System(rates={x: tx.Noise("w", density=tx.Parameter("density", value=0.5)) - x}))
    kalmans = [
        kind(dynamics, [tx.Measurement("y", x, covariance=0.04)]) for kind in (SquareRootKalman, ErrorStateKalman)
    ]

    def slope(kalman: ErrorStateKalman) -> jax.Array:
        def likelihood(density: jax.Array) -> jax.Array:
            records = {"y": (TIMES, np.array([0.3, -0.1, 0.6]))}
            return kalman.run(records, {"x": 0.0}, 1.0, params={"density": density}).log_likelihood

        return jax.grad(likelihood)(jax.numpy.asarray(0.4))

    np.testing.assert_allclose(*(slope(kalman) for kalman in kalmans), rtol=1e-9)
