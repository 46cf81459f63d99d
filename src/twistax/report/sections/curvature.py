"""Whether a stationary point is a minimum, by dense eigenvalues in NumPy, without code of the solver."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy import ndarray as Array

from ...jax_inside import in_double
from ...trajectory.adapters.program import NonlinearProgram

#: A scaled multiplier above this binds if it is larger than its slack; a curvature below this counts as zero.
_BINDS, _FLAT = 1e-6, 1e-6


def is_saddle(result: Any) -> bool:
    """Whether the objective falls to second order along what a result's binding constraints leave free."""
    return bool((reduced_bends(result) < -_FLAT).any())


def reduced_bends(result: Any) -> Array:
    """Eigenvalues of the Lagrangian's second derivative on the null space of the constraints that bind; scaled.

    Those are the equalities, and the inequalities whose multiplier is larger than their slack.
    """
    problem, warm = result.problem, result.warm
    with in_double():
        data = problem.started().instance
        core = problem.core(1e-6, warm.point, data)
        program: NonlinearProgram = core.made.setdefault(
            "second order", NonlinearProgram(core.staged, data, with_copies=False)
        )
        x, lower, upper, of_bounds, of_rows = program.start(warm, data, core.units(warm.point, data))
        _, g = program.values(x)
        _, slopes = program.first_derivatives(x)
        bends = program.lagrangian_hessian(x, 1.0, of_rows)
    J, H = np.zeros((program.count, program.size)), np.zeros((program.size, program.size))
    J[program.jacobian.rows, program.jacobian.columns] = slopes
    H[program.hessian.rows, program.hessian.columns] = bends
    binds = program.equality | ((of_rows > _BINDS) & (of_rows > -g))
    at_bounds = (np.abs(of_bounds) > _BINDS) & (np.abs(of_bounds) > np.where(of_bounds > 0.0, upper - x, x - lower))
    _, sizes, basis = np.linalg.svd(np.concatenate([J[binds], np.eye(program.size)[at_bounds]]))
    free = basis[int((sizes > 1e-9 * sizes.max(initial=0.0)).sum()) :]
    return np.linalg.eigvalsh(free @ H @ free.T)
