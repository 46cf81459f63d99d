"""The functions that the solver's core calls are those of the transcription, as JAX computes it."""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
import pytest
from core_functions import assert_derivatives_by_differences, assert_derivatives_of_the_core, assert_values, staged_of

import twistax as tx
from twistax.expr.fields import Operand
from twistax.expr.node import Expr
from twistax.trajectory import Collocation, Problem
from twistax.trajectory.transcription.evaluation import moved
from twistax.trajectory.transcription.iterate import Iterate, Step

pytest.importorskip("llvmlite")


def shot() -> Problem:
    """A body turns and steers past a pillar: limits of states and controls, a free duration, a condition on the way."""
    p, attitude = tx.State("p", shape=(2,), max=5.0), tx.State("R", group=tx.SO3)
    u = tx.Control("u", shape=(3,), min=-2.0, max=2.0)
    rates = {p: tx.Concat(attitude[0, 0] + u[0], tx.Sin(p[0]) * u[1]), attitude: u * (1.0 + 0.3 * p[0])}
    dynamics = tx.compile(tx.System(rates=rates, constraints={"pillar": p @ p >= 0.1}))
    return Problem(
        dynamics,
        tx.Minimize(tx.Time() + p[0] ** 2, running=u @ u),
        nodes=6,
        final_time=(0.5, 4.0),
        initial={p: [1.0, 0.5], attitude: np.eye(3)},
        final=[{p: [0.0, 1.0]}, attitude[2, 2] >= 0.5],
        at={2: p[1] <= 0.9},
    )


def collocated() -> Problem:
    """The same kind by an implicit method, with a free parameter and an equality at the end."""
    x, attitude, k = tx.State("x", shape=(2,)), tx.State("R", group=tx.SO3), tx.Parameter("k", value=2.0)
    u = tx.Control("u", shape=(3,))
    rates = {x: tx.Concat(x[1], -k * tx.Sin(x[0]) + u[0]), attitude: u * (1.0 + 0.3 * x[0])}
    return Problem(
        tx.compile(tx.System(rates=rates)),
        tx.Minimize(tx.Time(), running=u @ u + x @ x),
        nodes=5,
        final_time=(1.0, 9.0),
        transcription=Collocation(tx.tableaus.GAUSS_LEGENDRE4, substeps=2),
        initial={x: [1.0, 0.0], attitude: np.eye(3)},
        final=[{x: [0.0, 0.0]}, attitude[2, 2] == 0.5],
        free={k: (1.0, 3.0)},
    )


def moved_by(group: Any, point: Iterate, step: Step) -> Iterate:
    """By JAX's retraction."""
    return Iterate(jax.vmap(group.retract)(point.xs, step.d), point.us + step.u, point.border + step.border)


def point_beside(problem: Problem) -> tuple[Any, Any]:
    """A random point, and what the problem is solved for."""
    started, free, rng = problem.started(), problem.shooting.free, np.random.default_rng(0)
    step = Step(
        np.where(free.d, 0.2 * rng.normal(size=free.d.shape), 0.0),
        0.3 * rng.normal(size=free.u.shape),
        np.where(free.border, 0.1, 0.0),
    )
    point = moved_by(problem.dynamics.group, started.point, step)
    return jax.tree.map(np.asarray, point), started.instance


def test_moves_are_those_of_the_group() -> None:
    problem = shot()
    point, given = point_beside(problem)
    staged, free, rng = staged_of(problem, given), problem.shooting.free, np.random.default_rng(3)
    step = Step(*(rng.normal(size=a.shape) for a in free))
    result = staged.point(moved(staged.transcription, staged.flat(point), staged.step(*step)))
    expected = moved_by(problem.dynamics.group, point, step)
    for a, b in zip(jax.tree.leaves(result), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-13)


@pytest.mark.parametrize("make", [shot, collocated])
def test_derivatives_are_those_of_the_values(make: Callable[[], Problem]) -> None:
    problem = make()
    assert_derivatives_by_differences(problem, *point_beside(problem))


@pytest.mark.parametrize("make", [shot, collocated])
def test_values_and_derivatives_are_those_of_jax(make: Callable[[], Problem]) -> None:
    problem = make()
    point, given = point_beside(problem)
    assert_values(problem, point, given)
    assert_derivatives_of_the_core(problem, point, given)
    assert len(staged_of(problem, given).parts[0].bounds.rows) > 0


@jax.custom_jvp
def _squared(v: jax.Array) -> jax.Array:
    shape = jax.ShapeDtypeStruct(v.shape, v.dtype)
    return jax.pure_callback(lambda v: np.asarray(v) ** 2, shape, v, vmap_method="expand_dims")


@_squared.defjvp
def _squared_jvp(primals: Any, tangents: Any) -> Any:
    (v,), (dv,) = primals, tangents
    return _squared(v), 2.0 * v * dv


class Drag(Expr):
    """v^2 by a function of Python."""

    v: Operand
    takes = ((),)
    gives = ()

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return _squared(values[0])


def test_a_function_without_kernel_is_called_back() -> None:
    """What calls back to Python has no native form: JAX runs it, and its derivatives are those that it declares."""
    x, v, u = tx.State("x"), tx.State("v"), tx.Control("u", min=-3.0, max=3.0)
    ends: dict[str, Any] = {"initial": {x: 0.0, v: 0.0}, "final": {x: 1.0, v: 0.0}}
    options: dict[str, Any] = {"nodes": 9, "final_time": 2.0, **ends}
    known, called = (
        Problem(tx.compile(tx.System(rates={x: v, v: u - 0.3 * drag})), tx.Minimize(running=u * u), **options)
        for drag in (v * v, Drag(v))
    )
    expected, found = known.solve(), called.solve()
    assert expected.solved
    assert found.solved
    assert found.cost == pytest.approx(expected.cost, rel=1e-9)
