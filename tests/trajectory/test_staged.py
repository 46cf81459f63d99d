"""The functions that the solver's core calls are those of the transcription, as JAX computes it."""

import ctypes
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
import pytest

import twistax as tx
from twistax.expr.node import Expr, Operand
from twistax.trajectory import Collocation, Problem
from twistax.trajectory.evaluated import Evaluated, moved
from twistax.trajectory.staged import Staged
from twistax.trajectory.transcribed import Step

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
        transcription=Collocation(tx.tableaus.GAUSS_LEGENDRE4),
        initial={x: [1.0, 0.0], attitude: np.eye(3)},
        final=[{x: [0.0, 0.0]}, attitude[2, 2] == 0.5],
        free={k: (1.0, 3.0)},
    )


def point_beside(problem: Problem) -> tuple[Any, Any]:
    """A random point, and what the problem is solved for."""
    started, own, rng = problem.started(), problem.shooting, np.random.default_rng(0)
    step = Step(
        np.where(own.free.d, 0.2 * rng.normal(size=own.free.d.shape), 0.0),
        0.3 * rng.normal(size=own.free.u.shape),
        np.where(own.free.border, 0.1, 0.0),
    )
    return jax.tree.map(np.asarray, own.move(started.point, step)), started.given


def staged(problem: Problem, given: Any) -> Staged:
    return Staged(problem.shooting, problem.parts, given)


@pytest.mark.parametrize("make", [shot, collocated])
def test_values_are_those_of_the_transcription(make: Callable[[], Problem]) -> None:
    problem = make()
    point, given = point_beside(problem)
    own = staged(problem, given)
    at = Evaluated(own.transcription, own.flat(point))
    expected = jax.jit(problem.shooting.values)(point, given)
    np.testing.assert_allclose(at.cost[0], expected.cost, rtol=1e-13)
    np.testing.assert_allclose(at.c.reshape(expected.defects.shape), expected.defects, atol=1e-13)
    v, (lower, upper) = own.coordinates(point), own.limits(point, given)
    exists = problem.shooting.exists
    rows = own.all_rows(at.h, at.e, lower - v, v - upper)
    np.testing.assert_allclose(rows[exists], np.asarray(expected.rows)[exists], atol=1e-12)
    assert len(own.parts[0].bounds.rows) > 0


@pytest.mark.parametrize("make", [shot, collocated])
def test_first_derivatives_are_those_of_the_values(make: Callable[[], Problem]) -> None:
    """By central differences along random steps; defects count about where intervals end, so the next node stays."""
    problem = make()
    point, given = point_beside(problem)
    own = staged(problem, given)
    z, stages = own.flat(point), own.transcription.stages
    at = Evaluated(own.transcription, z)
    assert at.differentiate()
    rng, size = np.random.default_rng(1), 1e-5
    for _ in range(3):
        step = rng.normal(size=stages.variables)
        ends = [Evaluated(own.transcription, moved(own.transcription, z, side * size * step)) for side in (1.0, -1.0)]
        cost, h, e = ((getattr(ends[0], name) - getattr(ends[1], name)) / (2.0 * size) for name in ("cost", "h", "e"))
        np.testing.assert_allclose(at.gradient @ step, cost[0], rtol=1e-7)
        for name, counts, change in (("Jh", stages.inequalities, h), ("Je", stages.equalities, e)):
            blocks, first = at.blocks(getattr(at, name), counts), 0
            for k, block in enumerate(blocks):
                own_step = np.concatenate([_of_stage(own, step, k), step[len(step) - stages.parameters :]])
                rows = change[first : first + counts[k]]
                np.testing.assert_allclose(block @ own_step, rows, atol=1e-6 * (1.0 + np.abs(rows).max(initial=0.0)))
                first += counts[k]


@pytest.mark.parametrize("make", [shot, collocated])
def test_derivatives_are_those_of_the_transcription(make: Callable[[], Problem]) -> None:
    """Rows of the dynamics times the left Jacobian of the defect; weights of second derivatives likewise."""
    problem = make()
    point, given = point_beside(problem)
    own, shooting, rng = staged(problem, given), problem.shooting, np.random.default_rng(2)
    at = Evaluated(own.transcription, own.flat(point))
    assert at.differentiate()
    lam, w = rng.normal(size=(shooting.intervals, shooting.n)), np.zeros(len(shooting.exists))
    w[shooting.exists] = rng.normal(size=int(shooting.exists.sum()))
    values = jax.jit(shooting.values)(point, given)
    turn = jax.vmap(shooting.dynamics.group.left_jacobian)(values.defects)
    weights = np.einsum("kij,ki->kj", turn, lam)
    expected = jax.jit(shooting.derivatives)(point, weights, w, given)
    F = np.stack(at.blocks(at.F, own.transcription.stages.after)[:-1])
    np.testing.assert_allclose(F, turn @ np.asarray(expected.defects), atol=1e-12)
    y, ye, *_ = own.split_rows(w)
    H = np.zeros_like(at.H)
    function = ctypes.CFUNCTYPE(ctypes.c_int32, *[ctypes.c_void_p] * 2, ctypes.c_double, *[ctypes.c_void_p] * 4)
    functions, z = own.transcription.functions, np.ascontiguousarray(own.flat(point))
    arrays = (np.ascontiguousarray(lam), y, ye, H)
    function(functions.hessians)(functions.user, z.ctypes.data, 1.0, *(a.ctypes.data for a in arrays))
    *inner, end = at.blocks(H, own.transcription.stages.columns)
    scale = np.abs(np.asarray(expected.hessian)).max()
    np.testing.assert_allclose(np.stack(inner), expected.hessian, atol=1e-12 * scale)
    np.testing.assert_allclose(end, expected.end_hessian, atol=1e-12 * scale)


def _of_stage(own: Staged, step: Any, k: int) -> Any:
    """The entries of v of a stage."""
    stages = own.transcription.stages
    first = own.first[k]
    return step[first : first + stages.states[k] + stages.controls[k]]


def test_moves_are_those_of_the_group() -> None:
    problem = shot()
    point, given = point_beside(problem)
    own, free, rng = staged(problem, given), problem.shooting.free, np.random.default_rng(3)
    step = Step(rng.normal(size=free.d.shape), rng.normal(size=free.u.shape), rng.normal(size=free.border.shape))
    found = own.point(moved(own.transcription, own.flat(point), own.step(*step)))
    expected = problem.shooting.move(point, step)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-13)


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
