"""Values and derivatives that the solver's core gets, beside those of JAX."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy import ndarray as Array
from trajectory_systems import quick_jit

from twistax.trajectory import Problem
from twistax.trajectory.transcription.evaluation import Evaluated, moved
from twistax.trajectory.transcription.iterate import Instance, Iterate, Step, Values
from twistax.trajectory.transcription.jax_values import JaxValues
from twistax.trajectory.transcription.staged import Staged


def staged_of(problem: Problem, given: Instance) -> Staged:
    return Staged(problem.shooting, problem.parts, given)


def core_values(staged: Staged, point: Iterate, given: Instance) -> Values:
    """Those of the core, by node and row."""
    staged.set_instance(given)
    at = Evaluated(staged.transcription, staged.flat(point))
    v = staged.coordinates(staged.flat(point))
    lower, upper = staged.limits(v, given)
    return Values(at.cost[0], staged.padded(at.c), staged.all_rows(at.h, at.e, lower - v, v - upper))


def assert_values(problem: Problem, point: Iterate, given: Instance) -> None:
    """The core's are those of JAX."""
    values = core_values(staged_of(problem, given), point, given)
    expected = quick_jit(JaxValues(problem.shooting))(point, given)
    np.testing.assert_allclose(values.cost, expected.cost, rtol=1e-13)
    np.testing.assert_allclose(values.defects, expected.defects, atol=1e-13)
    exists = problem.shooting.exists
    np.testing.assert_allclose(values.rows[exists], np.asarray(expected.rows)[exists], atol=1e-12)


def assert_derivatives_of_the_core(problem: Problem, point: Iterate, given: Instance) -> None:
    """First ones along a random step, and the second of the Lagrangian, beside JAX's of the values.

    Rows of the dynamics count about where an interval ends: they are the left Jacobian of the defect times JAX's.
    """
    rng, phase, values = np.random.default_rng(2), problem.shooting, JaxValues(problem.shooting)
    staged = staged_of(problem, given)
    stages, at = staged.transcription.stages, Evaluated(staged.transcription, staged.flat(point))
    assert at.differentiate()
    lam, w = rng.normal(size=(phase.intervals, phase.n)), np.zeros(len(phase.exists))
    w[phase.exists] = rng.normal(size=int(phase.exists.sum()))
    w = staged.all_rows(*staged.split_rows(w))  # of rows that are one bound, one weight
    turn = jax.vmap(phase.dynamics.group.left_jacobian)(staged.padded(at.c))
    weights = np.einsum("kij,ki->kj", turn, lam)
    along = Step(*(rng.normal(size=a.shape) for a in phase.free))
    here = Step(np.zeros_like(along.d), point.us, point.border)

    def values_at(step: Step) -> Values:
        return values(Iterate(point.xs, step.u, step.border), given, jnp.asarray(step.d))

    def lagrangian(step: Step) -> Any:
        at = values_at(step)
        return at.cost + (weights * at.defects).sum() + w @ at.rows

    slopes = quick_jit(lambda: jax.jvp(values_at, (here,), (along,))[1])()
    v = staged.step(*along)
    shared = v[len(v) - stages.parameters :]
    of_stages = [
        np.concatenate([v[a : a + n - stages.parameters], shared]) for a, n in zip(stages.first, stages.columns)
    ]
    np.testing.assert_allclose(at.gradient @ v, slopes.cost, rtol=1e-10, atol=1e-10)
    F = [block @ step for block, step in zip(at.blocks(at.F, stages.after), of_stages)]
    expected = np.einsum("kij,kj->ki", turn, np.asarray(slopes.defects) + along.d[1:])
    np.testing.assert_allclose(np.stack(F[:-1]), expected, atol=1e-10 * np.abs(expected).max())
    h, e, *_ = staged.split_rows(np.asarray(slopes.rows))
    for flat, counts, rows in ((at.Jh, stages.inequalities, h), (at.Je, stages.equalities, e)):
        products = [block @ step for block, step in zip(at.blocks(flat, counts), of_stages)]
        np.testing.assert_allclose(np.concatenate(products), rows, atol=1e-10 * (1.0 + np.abs(rows).max(initial=0.0)))

    bent = quick_jit(lambda: jax.jvp(jax.grad(lagrangian), (here,), (along,))[1])()
    y, ye, *_ = staged.split_rows(w)
    blocks = at.blocks(at.hessian(1.0, staged.unpadded(lam), y, ye), stages.columns)
    product = np.zeros(len(v))
    for a, block, step in zip(stages.first, blocks, of_stages):
        count = len(step) - stages.parameters
        product[a : a + count] += (block @ step)[:count]
        product[len(v) - stages.parameters :] += (block @ step)[count:]
    expected = staged.step(*map(np.asarray, bent))
    np.testing.assert_allclose(product, expected, atol=1e-9 * np.abs(expected).max())


def assert_derivatives_by_differences(problem: Problem, point: Iterate, given: Instance) -> None:
    """First and second ones of the core along random steps by differences of its values.

    Every other node rests: defects count about where intervals end.
    """
    rng, phase, staged = np.random.default_rng(3), problem.shooting, staged_of(problem, given)
    stages, z = staged.transcription.stages, staged.flat(point)
    at = Evaluated(staged.transcription, z)
    assert at.differentiate()
    turn = np.asarray(jax.vmap(phase.dynamics.group.left_jacobian)(staged.padded(at.c)))
    y, ye = rng.normal(size=len(at.h)), rng.normal(size=len(at.e))
    for parity in range(2):
        moves = np.arange(phase.nodes) % 2 == parity
        along = Step(*(rng.normal(size=a.shape) for a in phase.free))
        v = staged.step(along.d * moves[:, None], along.u, along.border * point.border / 10.0)
        lam = np.where(~moves[1:, None], rng.normal(size=(phase.intervals, phase.n)), 0.0)
        weights = np.einsum("kij,ki->kj", turn, lam).ravel()

        def lagrangian(size: float, v: Array = v, weights: Array = weights) -> Array:
            """The cost, and all of it with multipliers."""
            there = Evaluated(staged.transcription, moved(staged.transcription, z, size * v))
            cost = there.cost[0]
            return np.array([cost, cost + weights @ there.c + y @ there.h + ye @ there.e])

        far, near, here, after, end = (lagrangian(size * 1e-3) for size in (-2, -1, 0, 1, 2))
        first = (8.0 * (after - near) - (end - far)) / (12.0 * 1e-3)
        second = (16.0 * (after + near) - (end + far) - 30.0 * here) / (12.0 * 1e-6)
        shared = v[len(v) - stages.parameters :]
        steps = [np.r_[v[a : a + n - stages.parameters], shared] for a, n in zip(stages.first, stages.columns)]
        slopes = ((at.F, stages.after, lam.ravel()), (at.Jh, stages.inequalities, y), (at.Je, stages.equalities, ye))
        slope = at.gradient @ v
        np.testing.assert_allclose(slope, first[0], rtol=1e-6, atol=1e-6)
        for flat, counts, multipliers in slopes:
            rows = [block @ step for block, step in zip(at.blocks(flat, counts), steps)]
            slope += multipliers @ np.concatenate(rows)
        np.testing.assert_allclose(slope, first[1], rtol=1e-6, atol=1e-6)
        blocks = at.blocks(at.hessian(1.0, lam.ravel(), y, ye), stages.columns)
        bend = sum(step @ block @ step for block, step in zip(blocks, steps))
        np.testing.assert_allclose(bend, second[1], rtol=1e-5, atol=1e-4)
