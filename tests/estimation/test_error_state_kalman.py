"""The error-state filter against the exact Kalman filter in NumPy, and against GTSAM on groups."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import twistax as tx
from twistax.estimation import ErrorStateKalman

A = np.array([[0.0, 1.0], [-4.0, -0.3]])
B, DENSITY, R = np.array([0.0, 1.0]), 0.3, 0.04
x = tx.State("x", shape=(2,))
OSCILLATOR = tx.compile(
    tx.System(rates={x: A @ x + B * (tx.Control("u") + tx.Noise("w", density=tx.Parameter("density", value=DENSITY)))})
)
POSITION = tx.Measurement("position", x[0], covariance=tx.Parameter("R", value=R))
TIMES = np.array([0.1, 0.25, 0.3, 0.7, 1.1, 1.15])
VALUES = np.array([0.8, 1.2, -0.3, 0.4, 0.1, -0.9])


def filter_of(**options: Any) -> ErrorStateKalman:
    return ErrorStateKalman(OSCILLATOR, [POSITION], max_step=0.002, **options)


def exact(times: np.ndarray, values: np.ndarray, u: float) -> tuple[np.ndarray, np.ndarray, float]:
    """The Kalman filter with exact transitions; the covariance of the noise by quadrature; and the log-likelihood."""
    m, P, before, total = np.array([1.0, 0.0]), np.eye(2), 0.0, 0.0
    nodes, weights = np.polynomial.legendre.leggauss(20)
    for t, z in zip(times, values, strict=True):
        h = t - before
        F = expm(A * h)
        points = 0.5 * h * (nodes + 1.0)
        columns = np.array([expm(A * s) @ B for s in points])
        Q = DENSITY**2 * np.einsum("s,si,sj->ij", 0.5 * h * weights, columns, columns)
        m = F @ m + np.linalg.solve(A, (F - np.eye(2)) @ B) * u
        P, before = F @ P @ F.T + Q, t
        if np.isfinite(z):
            S, r = P[0, 0] + R, z - m[0]
            K = P[:, 0] / S
            m, P = m + K * r, P - np.outer(K, K) * S
            total -= 0.5 * (r * r / S + np.log(2.0 * np.pi * S))
    return m, P, total


def test_the_linear_case_is_the_exact_kalman_filter() -> None:
    run = filter_of().run({"position": (TIMES, VALUES)}, {"x": np.array([1.0, 0.0])}, 1.0, t0=0.0, u={"u": 0.7})
    m, P, total = exact(TIMES, VALUES, 0.7)
    np.testing.assert_allclose(run.xs["x"][-1], m, atol=1e-12)
    np.testing.assert_allclose(run.P[-1], P, atol=1e-12)
    np.testing.assert_allclose(run.log_likelihood, total, rtol=1e-11)
    assert run.result == "successful"


@pytest.mark.parametrize("rtol", [1e-5, 1e-9])
def test_the_linear_case_with_long_intervals_is_exact_to_the_tolerance(rtol: float) -> None:
    kalman = ErrorStateKalman(OSCILLATOR, [POSITION], rtol=rtol)
    run = kalman.run({"position": (4.0 * TIMES, VALUES)}, {"x": np.array([1.0, 0.0])}, 1.0, t0=0.0, u={"u": 0.7})
    m, P, total = exact(4.0 * TIMES, VALUES, 0.7)
    np.testing.assert_allclose(run.xs["x"][-1], m, atol=4.0 * rtol)
    np.testing.assert_allclose(run.P[-1], P, atol=4.0 * rtol)
    np.testing.assert_allclose(run.log_likelihood, total, atol=40.0 * rtol)


def test_one_step_has_the_exact_covariance_whatever_its_length() -> None:
    """By Van Loan, so of a linear system without an error of the step; the oracle integrates the Riccati equation."""
    kalman = ErrorStateKalman(OSCILLATOR, [POSITION])
    Q = kalman.predict(0.0, {"x": np.zeros(2)}, 0.0, 0.5, {"u": 0.0}).P

    def rate(_: float, P: np.ndarray) -> np.ndarray:
        M = P.reshape(2, 2)
        return (A @ M + M @ A.T + DENSITY**2 * np.outer(B, B)).ravel()

    exact_Q = solve_ivp(rate, (0.0, 0.5), np.zeros(4), rtol=1e-12, atol=1e-14).y[:, -1].reshape(2, 2)
    np.testing.assert_allclose(Q, exact_Q, rtol=1e-10)


def test_records_come_in_any_order_and_may_be_missing() -> None:
    order = np.array([3, 0, 5, 1, 4, 2])
    values = np.where(np.arange(6) == 2, np.nan, VALUES)
    records = {"position": (TIMES[order], values[order])}
    run = filter_of().run(records, {"x": np.array([1.0, 0.0])}, 1.0, t0=0.0, u={"u": 0.0})
    m, P, total = exact(TIMES, values, 0.0)
    np.testing.assert_allclose(run.xs["x"][-1], m, atol=1e-12)
    np.testing.assert_allclose(run.P[-1], P, atol=1e-12)
    np.testing.assert_allclose(run.log_likelihood, total, rtol=1e-11)
    np.testing.assert_array_equal(run.innovations["position"].present, np.isfinite(values))
    np.testing.assert_array_equal(run.innovations["position"].ts, TIMES)


def test_the_gate_leaves_outliers_out() -> None:
    values = np.where(np.arange(6) == 2, 50.0, VALUES)
    start: Any = ({"x": np.array([1.0, 0.0])}, 1.0)
    run = filter_of(gate=0.999).run({"position": (TIMES, values)}, *start, t0=0.0, u={"u": 0.0})
    np.testing.assert_array_equal(run.innovations["position"].used, np.arange(6) != 2)
    m, P, _ = exact(TIMES, np.where(np.arange(6) == 2, np.nan, VALUES), 0.0)
    np.testing.assert_allclose(run.xs["x"][-1], m, atol=1e-12)
    np.testing.assert_allclose(run.P[-1], P, atol=1e-12)
    assert "1 gated" in run.explain()


def test_controls_may_be_a_table_that_jumps_between_records() -> None:
    table = tx.ZeroOrderHold([0.0, 0.1705], [1.0, -2.0])
    start: Any = ({"x": np.array([1.0, 0.0])}, 1.0)
    jump = filter_of().run({"position": ([0.3], [0.5])}, *start, t0=0.0, u={"u": table}).prior_xs["x"][-1]
    m = np.array([1.0, 0.0])
    for h, u in ((0.1705, 1.0), (0.1295, -2.0)):
        F = expm(A * h)
        m = F @ m + np.linalg.solve(A, (F - np.eye(2)) @ B) * u
    np.testing.assert_allclose(jump, m, atol=1e-12)


def test_jit_vmap_and_grad() -> None:
    kalman = ErrorStateKalman(OSCILLATOR, [POSITION])

    def likelihood(values: Any, params: Any) -> Any:
        run = kalman.run({"position": (TIMES, values)}, {"x": np.zeros(2)}, 1.0, t0=0.0, u={"u": 0.0}, params=params)
        return run.log_likelihood

    params = {"density": jnp.asarray(0.2), "R": jnp.asarray(0.05)}
    rows = np.stack([VALUES, 2.0 * VALUES, np.where(np.arange(6) == 1, np.nan, VALUES)])
    batch = jax.jit(jax.vmap(likelihood, (0, None)))(rows, params)
    np.testing.assert_allclose(batch, [likelihood(row, params) for row in rows], rtol=1e-12)
    slopes = jax.grad(likelihood, 1)(rows[2], params)
    for name, slope in slopes.items():
        step = 1e-6
        up, down = ({**params, name: params[name] + change} for change in (step, -step))
        difference = (likelihood(rows[2], up) - likelihood(rows[2], down)) / (2.0 * step)
        np.testing.assert_allclose(slope, difference, rtol=1e-6)


def test_single_precision_stays_single() -> None:
    start: Any = ({"x": np.zeros(2, np.float32)}, np.float32(1.0))
    run = ErrorStateKalman(OSCILLATOR, [POSITION]).run({"position": (TIMES, VALUES)}, *start, u={"u": 0.0})
    assert {a.dtype for a in jax.tree.leaves(run)} == {np.dtype("float32"), np.dtype(bool)}
    late = ErrorStateKalman(OSCILLATOR, [POSITION]).run({"position": (TIMES + 1e6, VALUES)}, *start, u={"u": 0.0})
    np.testing.assert_allclose(late.P, run.P, rtol=1e-5)


# ---- on groups -------------------------------------------------------------------------------------------------------

q = tx.State("q", group=tx.SO3)
RATE, FIELD = np.array([0.4, -0.7, 1.1]), np.array([0.3, -0.2, 0.9])
ATTITUDE = tx.compile(tx.System(rates={q: tx.Control("rate", shape=(3,)) + tx.Noise("n", shape=(3,), density=0.2)}))
ROTATED = np.asarray(tx.SO3.exp(np.array([0.5, 0.2, -0.8])))
SPREAD = np.array([[0.3, 0.1, 0.0], [0.1, 0.4, -0.05], [0.0, -0.05, 0.2]])
MAGNETIC = tx.Measurement("field", q.T @ FIELD, covariance=0.01)
MEASURED = np.array([0.1, 0.5, 0.8])


def transported(group: Any, d: Any) -> Any:
    """The reset of GTSAM, whose covariances are of left factors of d."""
    return group.Ad(group.exp(-d))


def test_an_update_on_a_group_is_that_of_gtsam() -> None:
    gtsam = pytest.importorskip("gtsam")
    update = ErrorStateKalman(ATTITUDE, [MAGNETIC], reset=transported).update(
        "field", 0.0, {"q": ROTATED}, SPREAD, MEASURED
    )
    peer = gtsam.ManifoldEKFRot3(gtsam.Rot3(ROTATED), SPREAD)
    predicted = ROTATED.T @ FIELD
    H = np.array(
        [[0.0, -predicted[2], predicted[1]], [predicted[2], 0.0, -predicted[0]], [-predicted[1], predicted[0], 0.0]]
    )
    peer.updateWithVector(predicted, H, MEASURED, 0.01 * np.eye(3))
    np.testing.assert_allclose(update.x["q"], peer.state().matrix(), atol=1e-12)
    np.testing.assert_allclose(update.P, peer.covariance(), atol=1e-12)


def test_a_prediction_on_a_group_is_that_of_gtsam() -> None:
    """With a constant rate, so that the mean is exact; the noise of isotropic density is h S^2 I on SO(3)."""
    gtsam = pytest.importorskip("gtsam")
    prediction = ErrorStateKalman(ATTITUDE, [MAGNETIC]).predict(0.0, {"q": ROTATED}, SPREAD, 0.3, {"rate": RATE})
    peer = gtsam.LieGroupEKFRot3(gtsam.Rot3(ROTATED), SPREAD)
    peer.predict(gtsam.Rot3(ROTATED @ expm(_hat(RATE * 0.3))), expm(-_hat(RATE * 0.3)), 0.3 * 0.04 * np.eye(3))
    np.testing.assert_allclose(prediction.x["q"], peer.state().matrix(), atol=1e-12)
    np.testing.assert_allclose(prediction.P, peer.covariance(), atol=1e-12)


def test_noise_turns_with_the_body() -> None:
    """Of a density for each axis: $Q = int_0^h Exp(-w s) W Exp(w s) ds$, by quadrature."""
    density = np.array([0.1, 0.3, 0.2])
    rates = {q: tx.Control("rate", shape=(3,)) + tx.Noise("n", shape=(3,), density=density)}
    kalman = ErrorStateKalman(tx.compile(tx.System(rates=rates)), [])
    Q = kalman.predict(0.0, {"q": ROTATED}, 0.0, 0.8, {"rate": RATE}).P
    nodes, weights = np.polynomial.legendre.leggauss(20)
    turns = [expm(-_hat(RATE) * 0.4 * (node + 1.0)) for node in nodes]
    exact_Q = sum(0.4 * weight * turn @ np.diag(density**2) @ turn.T for weight, turn in zip(weights, turns))
    np.testing.assert_allclose(Q, exact_Q, atol=1e-12)


def test_poses_are_those_of_gtsam() -> None:
    """Its Pose3 has tangents [w; v]; the measurement is a position."""
    gtsam = pytest.importorskip("gtsam")
    T = tx.State("T", group=tx.SE3, order=tx.ANGULAR_FIRST)
    dynamics = tx.compile(tx.System(rates={T: tx.Control("V", shape=(6,)) + tx.Noise("n", shape=(6,), density=0.0)}))
    kalman = ErrorStateKalman(
        dynamics, [tx.Measurement("gps", T[:3, 3], covariance=np.diag([0.1, 0.2, 0.3]))], reset=transported
    )
    rng = np.random.default_rng(3)
    root = rng.normal(size=(6, 6))
    pose, V, P = tx.pose(rotation=ROTATED, position=[1.0, -2.0, 0.5]), rng.normal(size=6), root @ root.T
    prior = kalman.predict(0.0, {"T": pose}, P, 0.2, {"V": V})
    post = kalman.update("gps", 0.2, prior.x, prior.P, np.array([0.7, -1.5, 0.2]))
    peer = gtsam.InvariantEKFPose3(gtsam.Pose3(pose), P)
    peer.predict(V, 0.2, np.zeros((6, 6)))
    np.testing.assert_allclose(prior.P, peer.covariance(), atol=1e-9)
    state = peer.state()
    H = np.hstack([np.zeros((3, 3)), state.rotation().matrix()])
    peer.updateWithVector(state.translation(), H, np.array([0.7, -1.5, 0.2]), np.diag([0.1, 0.2, 0.3]))
    np.testing.assert_allclose(post.x["T"], peer.state().matrix(), atol=1e-9)
    np.testing.assert_allclose(post.P, peer.covariance(), atol=1e-9)


def test_a_measured_rotation_halves_the_way_to_it() -> None:
    """A state and a measurement of one covariance: the estimate is the midpoint of the geodesic, at any angle."""
    star = tx.Measurement("star", q, covariance=0.3)
    d = np.array([1.5, -0.4, 0.9])
    update = ErrorStateKalman(ATTITUDE, [star]).update("star", 0.0, {"q": ROTATED}, 0.3, ROTATED @ expm(_hat(d)))
    np.testing.assert_allclose(update.x["q"], ROTATED @ expm(_hat(0.5 * d)), atol=1e-12)
    np.testing.assert_allclose(update.residual, d, atol=1e-12)
    J = np.eye(3)  # the right Jacobian by its series
    term = np.eye(3)
    for k in range(1, 30):
        term = term @ _hat(-0.5 * d) / (k + 1.0)
        J = J + term
    np.testing.assert_allclose(update.P, 0.15 * J @ J.T, atol=1e-12)


def test_what_is_not_finite_is_named() -> None:
    def unbounded(t: Any) -> dict[str, Any]:
        return {"u": jnp.where(t > 0.297, jnp.inf, 0.0)}

    with pytest.raises(tx.EstimationError, match=r"not finite at t = 0.3 s"):
        filter_of().run({"position": (TIMES, VALUES)}, {"x": np.zeros(2)}, 1.0, u=unbounded)


@pytest.mark.parametrize(
    ("records", "options", "message"),
    [
        ({"speed": (TIMES, VALUES)}, {}, "records names 'speed', but the filter has the measurements 'position'"),
        ({"position": (TIMES, VALUES[:3])}, {}, r"expects values of shape \(6,\)"),
        ({"position": ([0.1, 0.1], [1.0, 2.0])}, {}, "two values at one time"),
        ({"position": (TIMES, VALUES)}, {"t0": 0.2}, "before the start t0 = 0.2"),
        ({"position": (TIMES, VALUES)}, {"P0": np.diag([1.0, -1.0])}, "positive semidefinite"),
        ({"position": (TIMES, VALUES)}, {"u": {}}, "Control 'u' is missing"),
        ({}, {}, "t0 is not known"),
    ],
)
def test_bad_records_are_refused(records: Any, options: dict[str, Any], message: str) -> None:
    with pytest.raises((tx.InputError, tx.ShapeError), match=message):
        filter_of().run(records, {"x": np.zeros(2)}, **{"P0": 1.0, "u": {"u": 0.0}, **options})


def _hat(w: np.ndarray) -> np.ndarray:
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


@pytest.mark.parametrize(("nis", "used"), [(3.8, True), (3.9, False)])
def test_the_gate_is_a_quantile_of_chi_square(nis: float, used: bool) -> None:
    """3.841 at 0.95, of one degree of freedom; with P = R = 1 the innovation has the variance 2."""
    p = tx.State("p")
    dynamics = tx.compile(tx.System(rates={p: 0.0}))
    kalman = ErrorStateKalman(dynamics, [tx.Measurement("y", p, covariance=1.0)], gate=0.95)
    update = kalman.update("y", 0.0, {"p": 0.0}, 1.0, np.sqrt(2.0 * nis))
    np.testing.assert_allclose(update.nis, nis, rtol=1e-12)
    assert bool(update.used) is used
    np.testing.assert_allclose(update.P, [[0.5 if used else 1.0]])
