"""Implicit methods: order, stiffness, failures, and everything else a solution can do."""

import functools

import numpy as np
import pytest
from integrator_bodies import start
from scipy.integrate import solve_ivp

import twistax as tx
from oracles import skew
from twistax.scenes import stiff_attitude
from twistax.tableaus import (
    GAUSS_LEGENDRE4,
    GAUSS_LEGENDRE6,
    IMPLICIT,
    RADAU_IIA3,
    RADAU_IIA5,
    RADAU_IIA9,
    CollocationTableau,
)

RADAU, NINTH = tx.ImplicitRKMK(RADAU_IIA5), tx.ImplicitRKMK(RADAU_IIA9)

#: What the rates of `tumbling` are made of.
A, B, C = np.array([1.0, -0.5, 0.3]), np.array([0.4, 1.5, -0.7]), np.array([-0.6, 0.2, 0.9])


@functools.cache
def tumbling() -> tx.Dynamics:
    """A pose whose twist depends on its attitude, on another rotation, on a number and on time; nothing commutes."""
    g, Q, x, t = tx.State("g", group=tx.SE3), tx.State("Q", group=tx.SO3), tx.State("x"), tx.Time()
    w = g[:3, :3].T @ A + x * B
    v = tx.linalg.Cross(w, A) + Q @ C
    return tx.compile(
        tx.System(
            rates={
                g: tx.lie.twist(linear=v, angular=w),
                Q: Q.T @ B + tx.Sin(t) * C,
                x: tx.Cos(t) * g[0, 1] - x * Q[2, 0],
            }
        )
    )


def tumbler(number: int) -> dict[str, np.ndarray]:
    """A start."""
    pose = start(number)["g"]
    return {"g": pose, "Q": pose[:3, :3] @ pose[:3, :3], "x": np.array(0.3 + 0.1 * number)}


@functools.cache
def tumbled(number: int) -> dict[str, np.ndarray]:
    """Its end after a second, by SciPy on matrices."""

    def rate(t: float, y: np.ndarray) -> np.ndarray:
        R, Q, x = y[:9].reshape(3, 3), y[12:21].reshape(3, 3), y[21]
        w = R.T @ A + x * B
        v = np.cross(w, A) + Q @ C
        turn = Q @ skew(Q.T @ B + np.sin(t) * C)
        return np.concatenate([(R @ skew(w)).ravel(), R @ v, turn.ravel(), [np.cos(t) * R[0, 1] - x * Q[2, 0]]])

    x0 = tumbler(number)
    y0 = np.concatenate([x0["g"][:3, :3].ravel(), x0["g"][:3, 3], x0["Q"].ravel(), [x0["x"]]])
    y = solve_ivp(rate, (0.0, 1.0), y0, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = y[:9].reshape(3, 3), y[9:12]
    return {"g": pose, "Q": y[12:21].reshape(3, 3), "x": y[21]}


@functools.cache
def hold() -> tx.Dynamics:
    return tx.compile(stiff_attitude.system())


@functools.cache
def relaxation() -> tx.Dynamics:
    """x' = -k (x - cos t), whose solution is known."""
    x, k, t = tx.State("x"), tx.Parameter("k"), tx.Time()
    return tx.compile(tx.System(rates={x: -k * (x - tx.Cos(t))}))


def relaxed(k: float, t: np.ndarray) -> np.ndarray:
    """The solution from x = 2."""
    forced = (k**2 * np.cos(t) + k * np.sin(t)) / (k**2 + 1.0)
    return forced + (2.0 - k**2 / (k**2 + 1.0)) * np.exp(-k * t)


# ---- order -----------------------------------------------------------------------------------------------------------


#: The steps of the fit, by order: errors stay above round-off.
COUNTS = {1: (120, 160, 220), 3: (40, 56, 80), 4: (24, 34, 48), 5: (14, 20, 28), 6: (7, 9, 12), 9: (3, 4, 5)}


def fitted_order(method: tx.ImplicitRKMK, counts: tuple[int, ...]) -> float:
    """The slope of log error over log step, the error being the root of its mean square over four starts."""
    errors = []
    for count in counts:
        ends = [tx.integrate(tumbling(), tumbler(i), t1=1.0, steps=count, method=method).xs for i in range(4)]
        off = [np.ravel(end[name][-1] - value) for i, end in enumerate(ends) for name, value in tumbled(i).items()]
        errors.append(np.sqrt(np.mean(np.concatenate(off) ** 2)))
    assert min(errors) > 1e-13
    return -np.polyfit(np.log(counts), np.log(errors), 1)[0]


#: Those of three stages see what others would.
_LONG = (RADAU_IIA3, GAUSS_LEGENDRE4, RADAU_IIA9)


@pytest.mark.parametrize(
    "tableau",
    [pytest.param(t, marks=[pytest.mark.slow] if t in _LONG else [], id=t.name) for t in IMPLICIT],
)
def test_the_order_is_what_the_tableau_says(tableau: CollocationTableau) -> None:
    assert fitted_order(tx.ImplicitRKMK(tableau), COUNTS[tableau.order]) == pytest.approx(tableau.order, abs=0.2)


@pytest.mark.slow
def test_the_fit_sees_commutators_that_are_left_out() -> None:
    method = tx.ImplicitRKMK(RADAU_IIA5, tx.charts.Exponential(commutators=1))
    assert fitted_order(method, COUNTS[5]) < 4.5


@pytest.mark.parametrize(
    "chart",
    [pytest.param(tx.charts.SplitExponential(), marks=pytest.mark.slow), tx.charts.Ambient()],
    ids=lambda chart: repr(chart),
)
def test_other_charts_come_to_the_same_end(chart: tx.charts.Chart) -> None:
    end = tx.integrate(tumbling(), tumbler(0), t1=1.0, steps=40, method=tx.ImplicitRKMK(GAUSS_LEGENDRE6, chart)).xs
    for name, value in tumbled(0).items():
        np.testing.assert_allclose(end[name][-1], value, atol=1e-8)


# ---- stiffness -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("tableau", [RADAU_IIA3, RADAU_IIA5], ids=lambda tableau: tableau.name)
def test_one_step_takes_a_fast_transient_away(tableau: CollocationTableau) -> None:
    """Step times rate is 1e8: what is left of the transient is of the order of one over that."""
    sol = tx.integrate(
        relaxation(),
        {"x": 2.0},
        t1=1.0,
        steps=10,
        params={"k": 1e9},
        method=tx.ImplicitRKMK(tableau),
        save_at=[0.1, 1.0],
    )
    np.testing.assert_allclose(sol.xs["x"], relaxed(1e9, sol.ts), atol=1e-7)


def test_gauss_does_not_take_it_away() -> None:
    """It is A-stable only: the transient changes sign from step to step, and stays."""
    method = tx.ImplicitRKMK(GAUSS_LEGENDRE4)
    sol = tx.integrate(relaxation(), {"x": 2.0}, t1=1.0, steps=10, params={"k": 1e9}, method=method)
    assert abs(sol.xs["x"][-1] - relaxed(1e9, sol.ts)[-1]) > 0.9


@pytest.mark.parametrize("k", [1e2, 1e5, 1e8])
def test_tolerances_bound_the_error_at_every_rate(k: float) -> None:
    """The true ends were found in extended precision, by another method; the steps do not grow in number with k."""
    scene = stiff_attitude.scene(k)
    assert scene.reference is not None
    for method, tolerance, most in ((RADAU, 1e-5, 60), (RADAU, 1e-8, 300), (NINTH, 1e-8, 100)):
        sol = tx.integrate(
            hold(), scene.start, t1=scene.duration, params=scene.params, rtol=tolerance, atol=tolerance, method=method
        )
        assert sol.stats.steps < most
        for name, value in scene.reference.items():
            np.testing.assert_allclose(sol.xs[name][-1], value, atol=tolerance)


@pytest.mark.parametrize("k", [1e3, 1e7])
def test_stiffness_that_ends_with_a_jump(k: float) -> None:
    """Steps before and after the jump are of one length: what was learned before must not serve after it."""
    x, K, F, t = tx.State("x"), tx.Control("K"), tx.Control("F"), tx.Time()
    dynamics = tx.compile(tx.System(rates={x: F - K * (x - 1.0 - 0.1 * tx.Sin(t))}))
    u = {"K": tx.ZeroOrderHold(ts=[0.0, 1.0], values=[k, 0.0]), "F": tx.ZeroOrderHold(ts=[0.0, 1.0], values=[0.0, 1.0])}
    control = tx.StepControl(dtmax=0.125)
    options = {"u": u, "rtol": 1e-5, "control": control, "save_at": [0.3, 1.0, 1.3, 1.5]}
    sol = tx.integrate(dynamics, {"x": 1.0}, t1=1.5, dt=0.125, method=RADAU, **options)
    assert sol.stats.steps < 20
    np.testing.assert_allclose(sol.xs["x"][2:] - sol.xs["x"][1], [0.3, 0.5], atol=1e-13)
    np.testing.assert_allclose(sol.xs["x"][:2], 1.0 + 0.1 * np.sin([0.3, 1.0]), atol=1.0 / k)


@pytest.mark.parametrize("tableau", [RADAU_IIA5, RADAU_IIA9], ids=lambda tableau: tableau.name)
def test_stiffness_that_falls_smoothly_within_a_step(tableau: CollocationTableau) -> None:
    """Inverses from the start of a step make updates small at its later stages: one alone says nothing there."""
    x, w, t = tx.State("x"), tx.Parameter("w"), tx.Time()
    rate = 1.0 + 500.0 * (1.0 - tx.Tanh((t - 2.0) / w))
    dynamics = tx.compile(tx.System(rates={x: -rate * (x - tx.Cos(t))}))
    tolerance = 1e-4
    for width in (0.05, 0.01):

        def slope(t: float, x: np.ndarray, width: float = width) -> np.ndarray:
            return -(1.0 + 500.0 * (1.0 - np.tanh((t - 2.0) / width))) * (x - np.cos(t))

        exact = solve_ivp(slope, (0.0, 4.0), [1.0], method="Radau", rtol=1e-9, atol=1e-10, max_step=0.1).y[0, -1]
        options = {"rtol": tolerance, "atol": tolerance, "params": {"w": width}}
        sol = tx.integrate(dynamics, {"x": 1.0}, t1=4.0, method=tx.ImplicitRKMK(tableau), **options)
        assert abs(sol.xs["x"][-1] - exact) < tolerance


def test_an_explicit_method_needs_steps_as_short_as_the_fastest_rate() -> None:
    scene = stiff_attitude.scene(1e5)
    control = tx.StepControl(max_steps=2000)
    sol = tx.integrate(
        hold(), scene.start, t1=scene.duration, params=scene.params, rtol=1e-5, control=control, throw=False
    )
    assert sol.result is tx.Result.MAX_STEPS
