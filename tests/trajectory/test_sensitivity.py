"""Derivatives of optima against differences of tight solves."""

import functools
import os
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from trajectory_systems import EULER, HEUN

import twistax as tx
from twistax.errors import InputError, TrajectoryError
from twistax.trajectory import Collocation, Problem, Solution, solution


def centred(function: Callable[[Any], Any], at: np.ndarray, size: float) -> np.ndarray:
    """Extrapolated central differences, columns last."""
    near, far = (
        np.stack([(np.asarray(function(at + e * way)) - function(at - e * way)) / (2.0 * e) for way in np.eye(len(at))])
        for e in (size, 2.0 * size)
    )
    return np.moveaxis((4.0 * near - far) / 3.0, 0, -1)


def flat(found: Solution) -> Any:
    """All of it but the objective."""
    return jnp.concatenate([jnp.ravel(a) for a in jax.tree.leaves(found[1:])])


@functools.cache
def crane() -> Callable[..., Solution]:
    """Least time and effort over a distance, with force and speed at their limits on the way."""
    p, v, u = tx.State("p"), tx.State("v", max=0.8), tx.Control("u", min=-1.0, max=1.0)
    mass, price = tx.Parameter("mass", value=1.0), tx.Parameter("price", value=0.1)
    dynamics = tx.compile(tx.System(rates={p: v, v: u / mass}))
    problem = Problem(
        dynamics,
        tx.Minimize(tx.Time(), running=price * u**2),
        nodes=9,
        final_time=(0.5, 20.0),
        initial={p: 0.0, v: 0.0},
        final={p: 1.5, v: 0.0},
        **HEUN,
    )
    assert {"v <= 0.8", "u <= 1"} <= set(problem.solve(params={"mass": 0.9}, tolerance=1e-8).active)
    return solution(problem)


def of_crane(z: Any) -> Solution:
    initial, final = {"p": z[2], "v": z[3]}, {"p": z[4], "v": 0.0}
    return crane()(params={"mass": z[0], "price": z[1]}, initial=initial, final=final)


POINT = np.array([0.9, 0.12, 0.1, 0.05, 1.5])


def everything(z: Any) -> jax.Array:
    """The trajectory, and the optimal value last."""
    own = of_crane(z)
    return jnp.append(flat(own), own.cost)


@functools.cache
def forward() -> np.ndarray:
    return np.asarray(jax.jacfwd(everything)(POINT))


def test_the_trajectory_and_the_optimal_value() -> None:
    expected = centred(everything, POINT, 1e-3)
    np.testing.assert_allclose(forward()[:-1], expected[:-1], atol=1e-6 * np.abs(expected[:-1]).max())
    np.testing.assert_allclose(forward()[-1], expected[-1], atol=1e-6)
    np.testing.assert_allclose(jax.jacrev(everything)(POINT), forward(), atol=1e-10)


def test_under_jit() -> None:
    np.testing.assert_allclose(jax.jit(jax.grad(lambda z: of_crane(z).cost))(POINT), forward()[-1], rtol=1e-9)


ALONE = """
import os
os.sched_setaffinity(0, [min(os.sched_getaffinity(0))])
import jax
jax.config.update("jax_enable_x64", True)
import twistax as tx

x, u, k = tx.State("x"), tx.Control("u", min=-4.0, max=4.0), tx.Parameter("k", value=1.0)
problem = tx.trajectory.Problem(
    tx.compile(tx.System(rates={x: u / k})), tx.Minimize(tx.Time(), running=u**2), nodes=5, final_time=(0.1, 9.0),
    initial={x: 0.0}, final={x: 1.0},
)
optimum = tx.trajectory.solution(problem)
cost = lambda k: optimum(params={"k": k}).cost
plain = jax.grad(cost)(1.0)
assert abs(jax.jit(jax.grad(cost))(1.0) - plain) < 1e-9
assert abs(jax.jit(jax.vmap(jax.grad(cost)))(jax.numpy.ones(3)) - plain).max() < 1e-9
"""


@pytest.mark.thorough
@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="no affinities here")
def test_one_processor_is_enough() -> None:
    """XLA has one thread there, and a solve calls nothing back."""
    env = {key: value for key, value in os.environ.items() if key not in ("NPROC", "XLA_FLAGS")}
    done = subprocess.run([sys.executable, "-c", ALONE], env=env, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr


def test_with_the_settings_of_users(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where XLA_FLAGS says nothing programs have options of the compiler, which no program within another may have."""
    monkeypatch.setenv("XLA_FLAGS", "")
    x, u = tx.State("x"), tx.Control("u")
    dynamics = tx.compile(tx.System(rates={x: u}))
    objective = tx.Minimize(running=u**2)
    own = solution(Problem(dynamics, objective, nodes=2, final_time=1.0, initial={x: 0.0}, final={x: 1.0}, **EULER))
    slope = jax.grad(lambda end: own(final={"x": end}).cost)
    assert float(slope(1.5)) == pytest.approx(3.0, abs=1e-6)
    assert jax.jit(slope).lower(1.5)
    assert float(jax.jit(jax.jacfwd(lambda end: own(final={"x": end}).cost))(1.5)) == pytest.approx(3.0, abs=1e-6)


def test_poses_a_fixed_time_and_a_free_parameter() -> None:
    """A ball turns and stops; its start moves on the group, and a push is chosen with the torques."""
    R, w = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,))
    u, push = tx.Control("u", shape=(3,), min=-2.0, max=2.0), tx.Parameter("push", value=0.0)
    spin = u - tx.linalg.Cross(w, np.array([1.0, 2.0, 3.0]) * w) + push * np.array([1.0, 0.0, 0.5])
    problem = Problem(
        tx.compile(tx.System(rates={R: w, w: spin})),
        tx.Minimize(w @ w + 0.1 * push**2, running=u @ u),
        nodes=6,
        final_time=2.0,
        initial={R: np.eye(3), w: np.zeros(3)},
        final={R: np.asarray(tx.SO3.exp(np.array([0.3, -0.8, 1.1])))},
        free={push: (-1.0, 1.0)},
        **EULER,
    )
    # Euler's method is quick to compile, and derivatives are those of any mesh.
    optimum, goal = solution(problem, mesh_tolerance=np.inf), np.asarray(tx.SO3.exp(np.array([0.3, -0.8, 1.1])))

    def found(z: Any) -> Solution:
        start = tx.SO3.retract(np.eye(3), z[:3])
        return optimum(initial={"R": start, "w": z[3:6]}, final={"R": goal @ tx.SO3.exp(z[6:9])}, final_time=z[9])

    ways = np.random.default_rng(0).normal(size=(10, 2))

    def both(s: Any) -> Any:
        own = found(np.append(0.1 * np.arange(9.0), 2.0) + ways @ s)
        return jnp.concatenate([flat(own), own.free["push"][None], own.cost[None]])

    expected, own = centred(both, np.zeros(2), 1e-3), jax.jacfwd(both)(np.zeros(2))
    np.testing.assert_allclose(own, expected, atol=1e-6 * np.abs(expected).max())
    assert np.abs(expected[-2]).max() > 1e-3


@pytest.mark.parametrize("inner", [jax.jacrev, pytest.param(jax.jacfwd, marks=pytest.mark.slow)])
def test_second_derivatives(inner: Any) -> None:
    # w = c / (1 + c^2), by hand: without tangents of the multipliers the second derivative is half of it.
    x, w, c = tx.State("x"), tx.Control("w"), tx.Parameter("c", value=1.0)
    dynamics = tx.compile(tx.System(rates={x: c * w}))
    objective = tx.Minimize((x - 3.0) ** 2, running=w**2)
    optimum = solution(Problem(dynamics, objective, nodes=3, final_time=1.0, initial={x: 2.0}, **EULER))

    def found(c: Any) -> Any:
        own = optimum(params={"c": c})
        return jnp.stack([own.us["w"][0], own.cost])

    # The cost is 1 / (1 + c^2).
    np.testing.assert_allclose(jax.jacfwd(inner(found))(1.0), [-0.5, 0.5], atol=1e-6)


def test_what_is_not_solved_is_said() -> None:
    with pytest.raises(tx.TrajectoryError, match=r"the problem was not solved. INFEASIBLE"):
        crane()(initial={"p": 0.0, "v": 0.9 - 0.1}, final={"p": -1e-3, "v": 0.8}, params={"mass": 1e6})
    with pytest.raises(tx.TrajectoryError, match="the final time is free"):
        crane()(final_time=2.0)


def test_without_a_strict_minimum_there_is_no_derivative() -> None:
    """Of two thrusts one costs nothing, so when it is used does not matter."""
    x, dear, free = tx.State("x"), tx.Control("dear"), tx.Control("free")
    problem = Problem(
        tx.compile(tx.System(rates={x: dear + free})),
        tx.Minimize(running=dear * dear),
        nodes=3,
        final_time=1.0,
        initial={x: 0.0},
        final={x: 1.0},
        **EULER,
    )
    optimum = solution(problem)
    thrust = lambda end: optimum(final={"x": end}).us["free"]  # noqa: E731
    assert float(jnp.sum(thrust(2.0))) == pytest.approx(4.0)
    along = lambda end: jax.jvp(thrust, (end,), (1.0,))[1]  # noqa: E731
    with pytest.raises(TrajectoryError, match="no strict minimum"):
        along(1.0)
    assert np.isnan(jax.jit(along)(1.0)).all()
    with pytest.raises(InputError, match=r"final\['x'\] expects real numbers, got 'a'"):
        thrust("a")
    with pytest.raises(InputError, match=r"params names 'mass'; the problem has none"):
        jax.jit(lambda mass: optimum(params={"mass": mass}).cost)(1.0)


def test_a_problem_of_a_traced_function() -> None:
    """Stated, solved and warm started while JAX traces: all of it is of numbers, at once."""

    def stopped(z: Any) -> Any:
        x, v, u = tx.State("x"), tx.State("v"), tx.Control("u")
        dynamics = tx.compile(tx.System(rates={x: v, v: u}))
        start = {x: 0.0, v: 0.0}
        ends: dict[str, Any] = {"initial": start, "final": {x: 0.5, v: 0.0}}
        problem = Problem(dynamics, tx.Minimize(running=u**2), nodes=5, final_time=2.0, **ends, **HEUN)
        first = problem.solve(tolerance=1e-8)
        assert first.solved
        return z * problem.solve(warm=first, tolerance=1e-8).cost

    # The least held forces that move by half a metre and stop.
    moves = 0.5 * np.stack([1.75 - 0.5 * np.arange(4.0), np.ones(4)])
    least = 0.5 * np.sum((np.linalg.pinv(moves) @ [0.5, 0.0]) ** 2)
    np.testing.assert_allclose(jax.jit(stopped)(3.0), 3.0 * least, rtol=1e-7)


@functools.cache
def stiff_pendulum() -> tuple[Problem, Callable[[Any], Any]]:
    """By collocation, and its optimal value as a function of a parameter."""
    x, v, u, k = tx.State("x"), tx.State("v"), tx.Control("u"), tx.Parameter("k", value=2.0)
    problem = Problem(
        tx.compile(tx.System(rates={x: v, v: u - k * tx.Sin(x)})),
        tx.Minimize(running=u**2),
        nodes=5,
        final_time=2.0,
        initial={x: 1.0, v: 0.0},
        final={x: 0.0, v: 0.0},
        transcription=Collocation(tx.tableaus.GAUSS_LEGENDRE4),
    )
    optimum = solution(problem)
    return problem, lambda k: optimum(params={"k": k}).cost


def test_derivatives_of_a_collocated_optimum() -> None:
    problem, cost = stiff_pendulum()
    near, far = (
        (problem.solve(params={"k": 2.1 + e}, tolerance=1e-9).cost - problem.solve(params={"k": 2.1 - e}).cost)
        / (2.0 * e)
        for e in (1e-3, 2e-3)
    )
    assert jax.grad(cost)(2.1) == pytest.approx((4.0 * near - far) / 3.0, rel=1e-6)


def test_second_derivatives_of_a_collocated_optimum() -> None:
    _, cost = stiff_pendulum()
    slope = jax.grad(cost)
    assert jax.grad(slope)(2.1) == pytest.approx(float(slope(2.1 + 1e-4) - slope(2.1 - 1e-4)) / 2e-4, rel=1e-6)
