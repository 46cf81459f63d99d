"""Whether a stationary point is a minimum: dense, in NumPy, by none of what the solver does."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy import ndarray as Array

from ...precision import in_double
from ...trajectory.program import Program, Reference

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
        given = problem.started().given
        solver = problem._solver(1e-6, warm.point, given)
        program: Program = solver.made.setdefault("second order", solver.program(with_copies=False))
        scales, z = warm.scales, np.zeros(program.size)
        about = Reference(warm.point, scales, given)
        costates, weights = warm.dynamics * scales.d[1:] / scales.cost, warm.rows * scales.rows / scales.cost
        multipliers = program.flat_multipliers(costates, weights)
        _, g = program.values(z, about)
        _, slopes = program.slopes(z, about)
        bends = program.bend(z, about, 1.0, multipliers)
    J, H = np.zeros((program.count, program.size)), np.zeros((program.size, program.size))
    J[program.jacobian.rows, program.jacobian.columns] = slopes
    H[program.hessian.rows, program.hessian.columns] = bends
    binds = (program.lower == program.upper) | ((multipliers > _BINDS) & (multipliers > -g))
    _, sizes, basis = np.linalg.svd(J[binds])
    free = basis[int((sizes > 1e-9 * sizes.max(initial=0.0)).sum()) :]
    return np.linalg.eigvalsh(free @ H @ free.T)
