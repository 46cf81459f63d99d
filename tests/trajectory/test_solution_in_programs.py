"""Optima within programs of JAX: one call of the solver under jit, vmap and grad."""

import functools
import itertools
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from trajectory_systems import EULER, HEUN

import twistax as tx
from twistax.trajectory import Problem, Solution, solution


@functools.cache
def cart() -> Callable[..., Solution]:
    """A mass under drag, from a start to an end with limits on force and speed."""
    p, v, u = tx.State("p"), tx.State("v", max=0.9), tx.Control("u", min=-1.0, max=1.0)
    drag = tx.Parameter("drag", value=0.1)
    dynamics = tx.compile(tx.System(rates={p: v, v: u - drag * v * v}))
    return solution(
        Problem(
            dynamics,
            tx.Minimize(running=u**2 + 0.1 * p**2),
            nodes=11,
            final_time=3.0,
            initial={p: 0.0, v: 0.0},
            final={p: 1.0, v: 0.0},
            **HEUN,
        )
    )


def of_cart(z: Any) -> Solution:
    return cart()(params={"drag": z[0]}, initial={"p": z[1], "v": z[2]}, final={"p": z[3], "v": 0.0}, final_time=z[4])


POINT = np.array([0.2, 0.1, 0.05, 1.2, 2.5])


def flat(found: Solution) -> jax.Array:
    return jnp.concatenate([jnp.ravel(a) for a in jax.tree.leaves(found)])


def points(count: int) -> np.ndarray:
    return POINT + 0.05 * np.random.default_rng(1).normal(size=(count, len(POINT)))


def test_jit_gives_what_a_call_gives() -> None:
    own = of_cart(POINT)
    found = jax.jit(of_cart)(POINT)
    np.testing.assert_allclose(flat(found), flat(own), rtol=0.0, atol=1e-12)


def test_jit_and_vmap_give_what_a_call_gives() -> None:
    every = points(5)
    alone = np.stack([flat(of_cart(z)) for z in every])
    np.testing.assert_allclose(jax.jit(lambda z: flat(of_cart(z)))(every[0]), alone[0], rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(jax.vmap(lambda z: flat(of_cart(z)))(every), alone, rtol=0.0, atol=1e-12)
    both = jax.jit(jax.vmap(jax.vmap(lambda z: flat(of_cart(z)))))(every[None, :4].reshape(2, 2, -1))
    np.testing.assert_allclose(both.reshape(4, -1), alone[:4], rtol=0.0, atol=1e-12)


def test_derivatives_under_jit_and_vmap() -> None:
    everything = lambda z: flat(of_cart(z))  # noqa: E731
    forward, reverse = (way(everything) for way in (jax.jacfwd, jax.jacrev))
    own = np.asarray(jax.jit(forward)(POINT))
    np.testing.assert_allclose(jax.jit(reverse)(POINT), own, atol=1e-10 * np.abs(own).max())
    np.testing.assert_allclose(forward(POINT), own, atol=1e-10 * np.abs(own).max())
    step = 1e-4
    numeric = np.stack([(everything(POINT + step * e) - everything(POINT - step * e)) / (2 * step) for e in np.eye(5)])
    np.testing.assert_allclose(own, numeric.T, atol=3e-5 * np.abs(own).max())
    every = points(3)
    loop = np.stack([reverse(z) for z in every])
    np.testing.assert_allclose(jax.vmap(reverse)(every), loop, atol=1e-9 * np.abs(loop).max())
    np.testing.assert_allclose(jax.jit(jax.vmap(forward))(every), loop, atol=1e-9 * np.abs(loop).max())


def test_a_member_without_a_solution_has_no_derivative() -> None:
    """From 1 to 9 m in 2.5 s at 0.9 m/s there is no way."""
    every = points(3)
    every[1, 3] = 9.0
    found = jax.vmap(of_cart)(every)
    np.testing.assert_array_equal(found.solved, [1.0, 0.0, 1.0])
    slopes = jax.vmap(jax.grad(lambda z: of_cart(z).cost))(every)
    np.testing.assert_array_equal(np.isnan(slopes).any(axis=1), [False, True, False])
    np.testing.assert_array_equal(
        np.isnan(jax.jit(jax.vmap(jax.jacfwd(lambda z: flat(of_cart(z)))))(every)).any((1, 2)), [0, 1, 0]
    )
    np.testing.assert_allclose(slopes[2], jax.grad(lambda z: of_cart(z).cost)(every[2]), atol=1e-9)


def test_what_is_no_number_is_no_solution() -> None:
    """A drag, a start, a speed, an end and a time."""
    solved = jax.jit(jax.vmap(lambda z: of_cart(z).solved))
    slopes = jax.jit(jax.vmap(jax.grad(lambda z: of_cart(z).cost)))
    for place, wrong in itertools.product(range(5), (np.nan, np.inf)):
        every = jnp.stack([jnp.asarray(POINT), jnp.asarray(POINT).at[place].set(wrong)])
        assert solved(every).tolist() == [1.0, 0.0], (place, wrong)
        assert np.isfinite(slopes(every)).all(axis=1).tolist() == [True, False], (place, wrong)


def test_a_time_that_goes_back_is_no_solution() -> None:
    assert float(jax.jit(lambda z: of_cart(z).solved)(jnp.asarray(POINT).at[4].set(-2.0))) == 0.0


@pytest.mark.parametrize("is_box", [False, True])
def test_a_start_beyond_a_limit_is_no_solution(is_box: bool) -> None:
    """Nothing that the solver may choose changes such a row, so it has none of it."""
    p, v, u = tx.State("p", max=1.0 if is_box else None), tx.State("v"), tx.Control("u")
    system = tx.System(rates={p: v, v: u}, constraints={} if is_box else {"low": p <= 1.0})
    ends: dict[str, Any] = {"initial": {p: 0.5, v: 0.0}, "final": {p: 0.0, v: 0.0}}
    problem = Problem(tx.compile(system), tx.Minimize(running=u**2), nodes=11, final_time=2.0, **ends, **HEUN)
    found = solution(problem)
    starts = jnp.array([0.5, 0.9, 2.0])
    of = lambda x: found(initial={"p": x})  # noqa: E731
    solved, slopes = jax.jit(jax.vmap(lambda x: (of(x).solved, jax.grad(lambda x: of(x).cost)(x))))(starts)
    assert solved.tolist() == [1.0, 1.0, 0.0]
    assert np.isfinite(slopes).tolist() == [True, True, False]


def test_double_precision_inside_where_x64_is_off() -> None:
    """In single precision the conditions of an optimum would hold to 1e-4 at best."""
    slope = jax.grad(lambda z: of_cart(z).cost)
    expected = np.asarray(slope(POINT.astype(np.float32).astype(float)))
    with jax.enable_x64(False):
        single = jnp.asarray(POINT, jnp.float32)
        found = [slope(single), jax.jit(slope)(single), jax.vmap(slope)(single[None])[0]]
        cost = jax.jit(lambda z: of_cart(z).cost)(single)
        with pytest.raises(tx.TrajectoryError, match="second derivatives need double precision"):
            jax.hessian(lambda z: of_cart(z).cost)(single)
    assert cost.dtype == np.float32
    for own in found:
        assert own.dtype == np.float32
        np.testing.assert_allclose(own, expected, rtol=3e-6, atol=1e-6)


def test_programs_in_several_threads() -> None:
    every = points(8)
    run = jax.jit(jax.vmap(lambda z: flat(of_cart(z))))
    expected = np.asarray(run(every))
    found: list[np.ndarray] = []
    threads = [threading.Thread(target=lambda: found.append(np.asarray(run(every)))) for _ in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for own in found:
        np.testing.assert_array_equal(own, expected)


@jax.custom_jvp
def _sine(x: jax.Array) -> jax.Array:
    return jax.pure_callback(np.sin, jax.ShapeDtypeStruct(x.shape, x.dtype), x, vmap_method="expand_dims")


@_sine.defjvp
def _slope(primals: Any, tangents: Any) -> Any:
    return _sine(primals[0]), jnp.cos(primals[0]) * tangents[0]


class Sine(tx.Expr):
    """sin(x) by a function of Python."""

    x: tx.expr.fields.Operand
    takes = ((),)
    gives = ()

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return _sine(values[0])


def test_functions_that_jax_calls_back_are_refused_in_programs() -> None:
    x, u = tx.State("x"), tx.Control("u")
    problem = Problem(
        tx.compile(tx.System(rates={x: u + Sine(x)})),
        tx.Minimize(running=u**2),
        nodes=4,
        final_time=1.0,
        initial={x: 0.0},
        final={x: 1.0},
        **EULER,
    )
    optimum = solution(problem, mesh_tolerance=np.inf)
    cost = lambda end: optimum(final={"x": end}).cost  # noqa: E731
    assert float(cost(1.1)) == pytest.approx(problem.solve(final={x: 1.1}, tolerance=1e-8).cost, rel=1e-7)
    for way in (jax.jit(cost), lambda end: jax.vmap(cost)(jnp.full(2, end))):
        with pytest.raises(tx.TrajectoryError, match=r"under jit and vmap .* native form. JAX executes the rates"):
            way(1.0)


def test_what_does_not_fit_is_refused_when_a_program_is_made() -> None:
    with pytest.raises(tx.errors.ShapeError, match=r"initial\['p'\] expects shape \(\)"):
        jax.jit(lambda p: cart()(initial={"p": p, "v": 0.0}).cost)(jnp.zeros(2))
    with pytest.raises(tx.InputError, match="initial names 'q'"):
        jax.jit(lambda p: cart()(initial={"q": p}).cost)(1.0)


INTERRUPTED = """
import os, signal, sys, threading, time
import jax
signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored where tests run in the background
jax.config.update("jax_enable_x64", True)
import jax.numpy as jnp
import twistax as tx

x, u = tx.State("x"), tx.Control("u", min=-4.0, max=4.0)
problem = tx.trajectory.Problem(
    tx.compile(tx.System(rates={x: u})), tx.Minimize(tx.Time(), running=u**2), nodes=9, final_time=(0.1, 9.0),
    initial={x: 0.0}, final={x: 1.0},
)
optimum = tx.trajectory.solution(problem)
cost = lambda end: optimum(final={"x": end}).cost
ends = jnp.linspace(1.0, 2.0, 2_000_000)
run = jax.jit(jax.vmap(cost)).lower(ends).compile()
threading.Timer(0.5, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
begin = time.monotonic()
try:
    jax.block_until_ready(run(ends))
except KeyboardInterrupt:
    print("interrupted after", time.monotonic() - begin)
"""


@pytest.mark.thorough
@pytest.mark.skipif(os.name != "posix", reason="no signals of this kind here")
def test_an_interrupt_ends_what_would_take_minutes() -> None:
    begin = time.monotonic()
    done = subprocess.run([sys.executable, "-c", INTERRUPTED], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert "interrupted after" in done.stdout
    assert time.monotonic() - begin < 50.0
