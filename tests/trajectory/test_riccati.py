"""The recursion over stages against dense linear algebra on the same quadratic problem."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from twistax.trajectory.riccati import Rows, Solution, Stages, factorize, solve
from twistax.trajectory.transcribed import Derivatives

INTERVALS, N, M, BORDER, ROWS, END_ROWS = 4, 3, 2, 2, 3, 2
SIZE = N + M + BORDER
UNKNOWNS = (INTERVALS + 1) * N + INTERVALS * M + BORDER
FREE = {
    "free start": np.array([True] * (N + BORDER)),
    "fixed start": np.array([False] * N + [True] * BORDER),
    "part of the start and of the border": np.array([True, False, True, False, True]),
    "fixed start and border": np.zeros(N + BORDER, bool),
}


def symmetric(a: np.ndarray) -> np.ndarray:
    return 0.5 * (a + np.swapaxes(a, -1, -2))


def quadratic(seed: int, shift: float, free: np.ndarray) -> Stages:
    """Random stages; `shift` is added to the diagonal of the second derivatives, which else have both signs."""
    rng = np.random.default_rng(seed)
    slopes = Derivatives(
        defects=rng.normal(size=(INTERVALS, N, SIZE)),
        rows=rng.normal(size=(INTERVALS, ROWS, SIZE)),
        end_rows=rng.normal(size=(END_ROWS, N + BORDER)),
        gradient=rng.normal(size=(INTERVALS, SIZE)),
        end_gradient=rng.normal(size=N + BORDER),
        hessian=symmetric(rng.normal(size=(INTERVALS, SIZE, SIZE))) + shift * np.eye(SIZE),
        end_hessian=symmetric(rng.normal(size=(N + BORDER, N + BORDER))) + shift * np.eye(N + BORDER),
    )
    weights = Rows(rng.uniform(0.0, 1.0, (INTERVALS, ROWS)), rng.uniform(0.0, 1.0, END_ROWS))
    return Stages(slopes, weights, np.asarray(0.01), free)


def columns() -> tuple[list[list[int]], list[int], np.ndarray]:
    """Where z_k, z_K and the nodes (nodes, N) sit among all unknowns [d_0, u_0, ..., d_K, b]."""
    nodes = np.array([np.arange(N) + k * (N + M) for k in range(INTERVALS + 1)])
    border = range(UNKNOWNS - BORDER, UNKNOWNS)
    inner = [[*range(k * (N + M), (k + 1) * (N + M)), *border] for k in range(INTERVALS)]
    return inner, [*nodes[-1], *border], nodes


def dense(stages: Stages, defects: np.ndarray, rows: Rows) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The matrix and the right side for [free unknowns, multipliers of the dynamics], and which unknowns are free."""
    slopes, weights = stages.slopes, stages.weights
    inner, end, nodes = columns()
    hessian, pull = float(stages.damping) * np.eye(UNKNOWNS), np.zeros(UNKNOWNS)
    equations = np.zeros((INTERVALS * N, UNKNOWNS))
    for k in range(INTERVALS):
        j, w = slopes.rows[k], np.diag(weights.inner[k])
        hessian[np.ix_(inner[k], inner[k])] += slopes.hessian[k] + j.T @ w @ j
        pull[inner[k]] += slopes.gradient[k] + j.T @ w @ rows.inner[k]
        equations[k * N : (k + 1) * N, inner[k]] = slopes.defects[k]
        equations[k * N : (k + 1) * N, nodes[k + 1]] = -np.eye(N)
    j, w = slopes.end_rows, np.diag(weights.end)
    hessian[np.ix_(end, end)] += slopes.end_hessian + j.T @ w @ j
    pull[end] += slopes.end_gradient + j.T @ w @ rows.end
    free = np.ones(UNKNOWNS, bool)
    free[:N], free[-BORDER:] = stages.free_start[:N], stages.free_start[N:]
    hessian, equations = hessian[np.ix_(free, free)], equations[:, free]
    matrix = np.block([[hessian, equations.T], [equations, np.zeros((INTERVALS * N, INTERVALS * N))]])
    return matrix, -np.concatenate([pull[free], defects.ravel()]), free


factors_of, solution_of = jax.jit(factorize), jax.jit(solve)


def test_a_solution_has_its_derivative_backward_too() -> None:
    """Fixed starts leave zeros in the factors: a transpose must not divide by them."""
    stages = jax.tree.map(jnp.asarray, quadratic(1, 8.0, FREE["fixed start"]))
    factors, defects = factors_of(stages), jnp.ones((INTERVALS, N))
    rows = Rows(jnp.ones((INTERVALS, ROWS)), jnp.ones(END_ROWS))
    pulls = jnp.ones((INTERVALS, SIZE)), jnp.ones(N + BORDER)
    border = lambda own: solve(stages, factors, *pulls, own, rows).step.border  # noqa: E731
    backward, forward = jax.jit(lambda own: (jax.jacrev(border)(own), jax.jacfwd(border)(own)))(defects)
    np.testing.assert_allclose(backward, forward, rtol=1e-9, atol=1e-12)
    assert np.abs(forward).max() > 1e-3


@pytest.mark.parametrize("free", FREE.values(), ids=FREE)
def test_it_solves_the_dense_equations_where_they_have_the_inertia_of_a_minimum(free: np.ndarray) -> None:
    """And says so: as many negative eigenvalues as equations of the dynamics, all others positive."""
    rng, minima, indefinite = np.random.default_rng(9), [], 0
    defects = rng.normal(size=(INTERVALS, N))
    rows = Rows(rng.normal(size=(INTERVALS, ROWS)), rng.normal(size=END_ROWS))
    for seed in range(3):
        for shift in np.linspace(-1.0, 6.0, 15):
            stages = quadratic(seed, float(shift), free)
            slopes = stages.slopes
            matrix, right, moves = dense(stages, defects, rows)
            minima.append((np.linalg.eigvalsh(matrix) < 0.0).sum() == INTERVALS * N)
            factors = factors_of(stages)
            assert bool(factors.exist) == minima[-1]
            if not minima[-1]:
                continue
            indefinite += np.linalg.eigvalsh(slopes.hessian).min() < -0.5
            pulls = slopes.gradient, slopes.end_gradient
            found: Solution = jax.tree.map(np.asarray, solution_of(stages, factors, *pulls, defects, rows))
            expected = np.linalg.solve(matrix, right)
            step, multipliers = np.zeros(UNKNOWNS), expected[moves.sum() :].reshape(INTERVALS, N)
            step[moves] = expected[: moves.sum()]
            inner, end, nodes = columns()
            close = {"rtol": 1e-8, "atol": 1e-8 * np.abs(expected).max()}
            np.testing.assert_allclose(found.step.d, step[nodes], **close)
            np.testing.assert_allclose(found.step.u, [step[own][N : N + M] for own in inner], **close)
            np.testing.assert_allclose(found.step.border, step[-BORDER:], **close)
            np.testing.assert_allclose(found.dynamics, multipliers, **close)
            grown = [
                w * (j @ step[own] + r) for w, j, own, r in zip(stages.weights.inner, slopes.rows, inner, rows.inner)
            ]
            np.testing.assert_allclose(found.rows.inner, grown, **close)
            at_end = stages.weights.end * (slopes.end_rows @ step[end] + rows.end)
            np.testing.assert_allclose(found.rows.end, at_end, **close)
    assert 5 <= sum(minima) <= len(minima) - 5
    assert indefinite > 0


@pytest.mark.parametrize("interval", range(INTERVALS))
def test_a_maximum_in_one_interval_is_told(interval: int) -> None:
    """In the first one too, behind which nothing is left to factor where start and border are fixed."""
    stages = quadratic(0, 8.0, FREE["fixed start and border"])
    assert bool(factors_of(stages).exist)
    hessian = stages.slopes.hessian.copy()
    hessian[interval, N : N + M, N : N + M] -= 1e3 * np.eye(M)
    assert not bool(factors_of(stages._replace(slopes=stages.slopes._replace(hessian=hessian))).exist)
