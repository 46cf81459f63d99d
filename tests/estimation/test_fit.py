"""Parameters from data: against least squares by SciPy, exact likelihoods, and the Cramer-Rao bound."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import least_squares, minimize

import twistax as tx
from twistax.estimation import Experiment, HuberLoss, MaximumLikelihood

q, w = tx.State("q"), tx.State("w")
LENGTH, DAMPING = tx.Parameter("length"), tx.Parameter("damping")
PENDULUM = tx.compile(tx.System(rates={q: w, w: -9.81 / LENGTH * tx.Sin(q) - DAMPING * w}))
ANGLE = tx.Measurement("angle", q, covariance=0.01**2)
TIMES = np.linspace(0.0, 5.0, 51)


def rate(y: np.ndarray, p: np.ndarray) -> np.ndarray:
    return np.array([y[1], -9.81 / p[0] * np.sin(y[0]) - p[1] * y[1]])


def angles(p: np.ndarray) -> np.ndarray:
    """RK4 between the times, for length, damping, and both states at the start."""
    y, h, values = np.array(p[2:]), 0.1, [p[2]]
    for _ in TIMES[1:]:
        a = rate(y, p)
        b = rate(y + 0.5 * h * a, p)
        c = rate(y + 0.5 * h * b, p)
        y = y + h / 6.0 * (a + 2.0 * b + 2.0 * c + rate(y + h * c, p))
        values.append(y[0])
    return np.array(values)


TRUTH = np.array([0.8, 0.23, 1.2, 0.1])
MEASURED = angles(TRUTH) + 0.01 * np.random.default_rng(0).normal(size=51)


def pendulum(values: np.ndarray = MEASURED, **start: Any) -> Any:
    return Experiment({"angle": (TIMES, values)}, {"q": 1.0, "w": 0.0}, **start)


def test_from_far_away_it_is_the_least_squares_estimate_and_compiles_once() -> None:
    values = MEASURED.copy()
    values[[7, 20]] = np.nan
    seen = np.isfinite(values)
    best = least_squares(lambda p: (angles(p) - values)[seen] / 0.01, TRUTH, x_scale="jac", xtol=1e-12, ftol=1e-12)
    covariance = np.linalg.inv(best.jac.T @ best.jac)[:2, :2]
    arguments: Any = {"free": {LENGTH: (0.05, 20.0), DAMPING: (0.0, 10.0)}, "measurements": [ANGLE]}
    for start in ({"length": 8.0, "damping": 0.0}, {"length": 0.2, "damping": 1.0}):
        fit = tx.fit(PENDULUM, pendulum(values), params=start, **arguments)
        assert (fit.result, fit.undetermined, int(fit.residuals)) == ("successful", (), 49)
        np.testing.assert_allclose([fit.params["length"], fit.params["damping"]], best.x[:2], rtol=1e-6)
        np.testing.assert_allclose([fit.x0["q"][0], fit.x0["w"][0]], best.x[2:], atol=1e-6)
        np.testing.assert_allclose(fit.covariance, covariance, rtol=1e-3)
        np.testing.assert_allclose(fit.squares, 2.0 * best.cost, rtol=1e-9)
    estimators = [one for one in PENDULUM.functions.loops.values() if isinstance(one, MaximumLikelihood)]
    assert [one._solve._cache_size() for one in estimators] == [1]


# ---- what the data does not determine --------------------------------------------------------------------------------

K, C, M = (tx.Parameter(name, value=0.0) for name in ("log_k", "log_c", "log_m"))
FAST = 0.1 * np.arange(41)
SPRING = tx.compile(tx.System(rates={q: w, w: -(tx.Exp(K) * q + tx.Exp(C) * w) / tx.Exp(M)}))
OFFSET, USELESS = tx.Parameter("offset", value=0.0), tx.Parameter("useless", value=0.0)
NO_SHIFT = tx.Measurement("y", q, covariance=0.02**2)
SPRING_TRUTH = {"log_k": np.log(4.0), "log_c": np.log(0.3), "log_m": np.log(1.5)}


def spring(params: Any) -> np.ndarray:
    """Exact positions from a start at one, (41,)."""
    k, c, m = (np.exp(params[name]) for name in SPRING_TRUTH)
    A = np.array([[0.0, 1.0], [-k / m, -c / m]])
    return np.array([(expm(A * t) @ [1.0, 0.0])[0] for t in FAST])


def deviations_over_the_bound(runs: int) -> tuple[np.ndarray, Any]:
    """Of the determined combinations over noise seeds, and the estimate without noise."""
    exact = spring(SPRING_TRUTH)
    problem = MaximumLikelihood(SPRING, [NO_SHIFT], [K, C, M], max_step=0.05, segments=2)

    def estimate(values: Any) -> Any:
        return problem.run(Experiment({"y": (FAST, values)}, {"q": 0.8, "w": 0.0}))

    seen = jnp.asarray(exact)[None] + 0.02 * jax.random.normal(jax.random.key(0), (runs, 41))
    fits = jax.jit(jax.vmap(estimate))(jnp.concatenate([jnp.asarray(exact)[None], seen]))
    assert fits.converged
    first = jax.tree.map(lambda a: a[0], fits)
    rows = np.stack([one.coefficients for one in first.combinations])
    values = np.stack([fits.params[name][1:] for name, _ in fits.shapes], axis=1) @ rows.T
    return values.std(axis=0, ddof=1) / [one.deviation for one in first.combinations], first


@pytest.mark.parametrize(
    ("runs", "low", "high"), [(60, 0.8, 1.2), pytest.param(200, 0.9, 1.15, id="200", marks=pytest.mark.slow)]
)
def test_determined_combinations_have_the_deviation_of_the_cramer_rao_bound(runs: int, low: float, high: float) -> None:
    ratios, exact = deviations_over_the_bound(runs)
    assert exact.undetermined == ("log_k + log_c + log_m",)
    assert [one.name for one in exact.combinations] == ["log_k - log_m", "log_c - log_m"]
    np.testing.assert_allclose(
        [one.value for one in exact.combinations], [np.log(4.0 / 1.5), np.log(0.3 / 1.5)], atol=1e-4
    )
    assert low < ratios.min() < ratios.max() < high
    with pytest.raises(tx.EstimationError, match=r"does not determine log_k \+ log_c \+ log_m"):
        exact.covariance  # noqa: B018
    assert all(np.isinf(value) for value in exact.deviations().values())


def test_every_combination_without_effect_is_named() -> None:
    """A product, a sum, and a parameter that nothing depends on; with several experiments, priors and a known start."""
    a, b = tx.Parameter("a", value=1.0), tx.Parameter("b", value=3.0)
    drift = tx.compile(tx.System(rates={q: a * b, w: 0.0 * w}))
    shifted = tx.Measurement("y", q + OFFSET + w * 0.0 + 0.0 * USELESS, covariance=tx.Parameter("R", value=0.04))
    ts = np.array([0.0, 0.5, 1.0, 2.0])
    data = [
        Experiment({"y": (ts, 2.0 * ts + 0.3)}, {"q": 0.0, "w": 0.0}, P0=0.0),
        Experiment({"y": (ts[:3], 2.0 * ts[:3] + 0.3)}, {"q": 0.0, "w": 0.0}, P0=0.0),
    ]
    free = [a, b, OFFSET, USELESS]
    problem = MaximumLikelihood(drift, [shifted], free, priors={USELESS: (5.0, 4.0)}, segments=1)
    fit = problem.run(data)
    np.testing.assert_allclose([fit.params["a"] * fit.params["b"], fit.params["offset"]], [2.0, 0.3], atol=1e-9)
    # $b da + a db$ is zero along the combination; the prior does not hide the parameter without effect.
    ratio = float(fit.params["b"] / fit.params["a"])
    assert sorted(fit.undetermined) == sorted([f"- {1 / ratio:.3g} a + b", "useless"])
    assert [one.name for one in fit.combinations] == [f"a + {1 / ratio:.3g} b", "offset"]
    np.testing.assert_allclose(fit.params["useless"], 5.0)
    np.testing.assert_allclose(fit.deviations()["useless"], 2.0)
    # Seven measurements of offset + rate t.
    t = np.concatenate([ts, ts[:3]])
    inverse = np.linalg.inv(np.array([[t @ t, t.sum()], [t.sum(), 7.0]]) / 0.04)
    np.testing.assert_allclose(fit.deviations()["offset"], np.sqrt(inverse[1, 1]), rtol=1e-9)


# ---- outliers --------------------------------------------------------------------------------------------------------


def test_robust_losses_keep_outliers_from_the_estimate() -> None:
    """10 % of the angles are wrong by half a radian. Beside SciPy's least squares with the same loss."""
    values, rng = MEASURED.copy(), np.random.default_rng(2)
    values[rng.choice(51, 5, replace=False)] += 0.5
    options: Any = {"x_scale": "jac", "xtol": 1e-12, "ftol": 1e-12, "f_scale": 1.345}
    huber, squares = (
        least_squares(lambda p: (angles(p) - values) / 0.01, TRUTH, loss=loss, **options)
        for loss in ("huber", "linear")
    )
    fit = tx.fit(
        PENDULUM,
        pendulum(values),
        free=[LENGTH, DAMPING],
        measurements=[ANGLE],
        losses={"angle": HuberLoss()},
        params={"length": 1.5, "damping": 0.0},
        segments=2,
    )
    found = np.array([fit.params["length"], fit.params["damping"]])
    np.testing.assert_allclose(found, huber.x[:2], rtol=1e-6)
    np.testing.assert_allclose(fit.cost, huber.cost + 51 * (np.log(0.01) + 0.5 * np.log(2.0 * np.pi)), rtol=1e-9)
    assert (np.abs(found - TRUTH[:2]) < 4.0 * np.array(list(fit.deviations().values()))).all()
    assert abs(squares.x[1] - TRUTH[1]) > 5.0 * abs(found[1] - TRUTH[1])


@pytest.mark.parametrize(
    ("losses", "message"),
    [
        ({"angel": HuberLoss()}, "the measurements are 'angle'"),
        ({"angle": HuberLoss()}, "no losses with noise in the rates"),
        ({"of size": HuberLoss()}, "known covariance of 'of size', which has a loss, but 'size' is free"),
        ({"noisy": HuberLoss()}, "known covariance of 'noisy', which has a loss, but 'size' is free"),
    ],
)
def test_losses_that_do_not_fit_are_refused(losses: Any, message: str) -> None:
    size = tx.Parameter("size", value=0.1)
    push = tx.Noise("push", density=0.1) if "rates" in message else 0.0
    dynamics = tx.compile(tx.System(rates={q: LENGTH * w, w: push - q}))
    sensors = [
        ANGLE,
        tx.Measurement("of size", q, covariance=size**2),
        tx.Measurement("noisy", q + tx.Noise("n", density=size), period=0.1),
    ]
    with pytest.raises(tx.ModelError, match=message):
        MaximumLikelihood(dynamics, sensors, [LENGTH, size], losses=losses)
    MaximumLikelihood(dynamics, sensors, [LENGTH, size])


# ---- bounds, priors, noise in the rates, groups ----------------------------------------------------------------------


def test_a_bound_is_kept_and_named() -> None:
    """The start has a prior, in SciPy two more residuals."""
    prior = lambda p: (p[2:] - [1.0, 0.0]) / [0.1, 0.05]  # noqa: E731
    best = least_squares(
        lambda p: np.concatenate([(angles(p) - MEASURED) / 0.01, prior(p), [(p[1] - 0.3) / 0.02]]),
        [0.75, 0.2, 1.0, 0.0],
        bounds=([0.1, 0.0, -9.0, -9.0], [0.79, 1.0, 9.0, 9.0]),
        x_scale="jac",
        xtol=1e-13,
        ftol=1e-13,
    )
    with pytest.warns(RuntimeWarning, match="on a bound of length"):
        fit = tx.fit(
            PENDULUM,
            pendulum(P0=[0.01, 0.0025]),
            free={LENGTH: (0.1, 0.79), DAMPING: (None, None)},
            measurements=[ANGLE],
            priors={DAMPING: (0.3, 0.02**2)},
            params={"damping": 0.1},
            segments=3,
        )
    np.testing.assert_allclose([fit.params["length"], fit.params["damping"]], [0.79, best.x[1]], rtol=1e-5)
    assert fit.names_on_bounds == ("length",)
    assert "on a bound: length" in fit.explain()


def test_noise_in_the_rates_makes_it_the_likelihood_of_innovations() -> None:
    """A leaky integrator in two experiments: rate, density and covariance of the measurement, by exact likelihood."""
    x = tx.State("x")
    leak, density, R = (tx.Parameter(name) for name in ("leak", "density", "R"))
    leaky = tx.compile(tx.System(rates={x: -leak * x + tx.Noise("n", density=density)}))
    sensor = tx.Measurement("y", x, covariance=R)
    rng, h, state, values = np.random.default_rng(3), 0.2, 2.0, []
    for _ in range(300):
        values.append(state + 0.2 * rng.normal())
        state = np.exp(-h) * state + np.sqrt(0.5 * (1.0 - np.exp(-2.0 * h))) * rng.normal()
    records = np.reshape(values, (2, 150))

    def cost(p: np.ndarray) -> float:
        """Of leak, density and R."""
        (a, b, S), total = p, 0.0
        for k, value in enumerate(records.flat):
            if k % 150:
                m, P = np.exp(-a * h) * m, np.exp(-2.0 * a * h) * P + b**2 * (1.0 - np.exp(-2.0 * a * h)) / (2.0 * a)
            else:
                m, P = 1.0, 4.0
            spread = P + S
            total += 0.5 * ((value - m) ** 2 / spread + np.log(2.0 * np.pi * spread))
            m, P = m + P / spread * (value - m), P * S / spread
        return total

    best = minimize(
        cost, [1.0, 1.0, 0.04], bounds=[(1e-4, 10.0)] * 3, method="Nelder-Mead", options={"xatol": 1e-8, "fatol": 1e-11}
    )
    fit = tx.fit(
        leaky,
        [Experiment({"y": (h * np.arange(150), record)}, {"x": 1.0}, P0=4.0) for record in records],
        {leak: (0.01, 10.0), density: (0.01, 10.0), R: (1e-4, 1.0)},
        measurements=[sensor],
        params={"leak": 0.3, "density": 0.3, "R": 0.3},
        max_step=0.1,
    )
    found = [fit.params[name] for name in ("leak", "density", "R")]
    np.testing.assert_allclose(found, best.x, rtol=2e-4)
    np.testing.assert_allclose(fit.cost, best.fun, atol=1e-6)
    assert fit.result == "successful"


@pytest.mark.slow
def test_a_fit_with_a_filter_is_made_of_kernels() -> None:
    """Of a pose and a twist, where the derivative of a whole step of the filter is too large for a kernel."""
    X, V, M = tx.State("X", group=tx.SE3), tx.State("V", shape=(6,)), np.diag([2.0, 2.0, 2.0, 1.0, 2.0, 3.0])
    drag, density = tx.Parameter("drag", shape=(6,)), tx.Parameter("density")
    force = -tx.lie.AdjointDual(V, M @ V) - drag * V
    push = tx.Noise("push", shape=(6,), density=density)
    body = tx.compile(tx.System(rates={X: V, V: tx.linalg.Solve(M, force) + push}))
    likelihood = MaximumLikelihood(body, [tx.Measurement("pose", X, covariance=1e-4)], [drag, density])
    ts, start = 0.1 * np.arange(1, 6), {"X": np.eye(4), "V": np.zeros(6)}

    def cost(poses: jax.Array) -> jax.Array:
        experiment = Experiment({"pose": (ts, poses)}, start, P0=1.0, t0=0.0)
        return likelihood.run(experiment, {"drag": np.ones(6), "density": 1.0}).cost

    program = jax.jit(cost).lower(jnp.broadcast_to(jnp.eye(4), (5, 4, 4))).as_text()
    assert program.count("\n") < 4000  # 2,544; with a step as one function 25,620


@pytest.mark.slow
def test_segments_on_a_group_change_nothing() -> None:
    """A spinning body seen by its attitude: moments of inertia to a common factor."""
    R, spin = tx.State("R", group=tx.SO3), tx.State("spin", shape=(3,))
    log_J = tx.Parameter("log_J", shape=(3,))
    J = tx.Exp(log_J)
    body = tx.compile(tx.System(rates={R: spin, spin: tx.linalg.Cross(J * spin, spin) / J}))
    star = tx.Measurement("star", R, covariance=1e-6)
    truth = np.log([1.0, 2.0, 2.5])
    ts, start = 0.1 * np.arange(41), {"R": np.eye(3), "spin": np.array([0.3, 1.0, -0.4])}
    exact = tx.integrate(body, start, t1=4.0, steps=40, params={"log_J": truth}, save_at=ts).xs["R"]
    errors = jnp.asarray(1e-3 * np.random.default_rng(0).normal(size=(41, 3)))
    seen = jax.vmap(lambda r, e: r @ tx.lie.so3.exp(e))(exact, errors)
    fits = [
        tx.fit(
            body,
            Experiment({"star": (ts, seen)}, start),
            ["log_J"],
            measurements=[star],
            params={"log_J": guess},
            segments=segments,
        )
        for segments, guess in ((4, np.array([0.0, 0.0, 0.1])), (1, truth + [0.05, 0.0, -0.05]))
    ]
    for fit in fits:
        assert fit.undetermined == ("log_J[0] + log_J[1] + log_J[2]",)
        for one, expected in zip(fit.combinations, truth[:2] - truth[2]):
            assert abs(one.value - expected) < 4.0 * one.deviation < 0.1
    values = [[one.value for one in fit.combinations] for fit in fits]
    np.testing.assert_allclose(*values, atol=1e-7)
    np.testing.assert_allclose(fits[0].squares, fits[1].squares, rtol=1e-8)


def test_what_does_not_converge_is_said_by_its_measure() -> None:
    with pytest.raises(tx.EstimationError, match="not converged after 1 steps: another would add"):
        tx.fit(
            PENDULUM,
            pendulum(),
            free=[LENGTH],
            measurements=[ANGLE],
            params={"length": 3.0, "damping": 0.2},
            segments=1,
            max_iterations=1,
        )


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"free": ["lenght"]}, tx.ModelError, "lenght"),
        ({"free": []}, tx.ModelError, "expects free parameters"),
        ({"measurements": []}, tx.ModelError, "expects measurements"),
        ({"params": {"damping": 0.1}}, tx.InputError, "an initial value for 'length'"),
        ({"params": {"damping": 0.1, "length": np.ones(2)}}, tx.ShapeError, r"params\['length'\]"),
        ({"priors": {DAMPING: (0.1, 0.1)}}, tx.ModelError, "priors names 'damping'"),
        ({"priors": {LENGTH: (0.1, -0.1)}}, tx.InputError, "positive definite"),
        ({"data": []}, tx.InputError, "Experiment"),
    ],
)
def test_bad_arguments_are_refused(change: Any, error: type[Exception], message: str) -> None:
    arguments = {
        "data": pendulum(),
        "free": [LENGTH],
        "measurements": [ANGLE],
        "params": {"damping": 0.1, "length": 1.0},
    } | change
    with pytest.raises(error, match=message):
        tx.fit(PENDULUM, **arguments)
