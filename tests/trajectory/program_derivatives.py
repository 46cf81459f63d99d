"""Derivatives of a program in stages against differences of its values."""

import numpy as np
import scipy.sparse

from twistax.trajectory.adapters.program import NonlinearProgram


def assert_derivatives(program: NonlinearProgram, x: np.ndarray, dx: np.ndarray, multipliers: np.ndarray) -> None:
    """First and second ones along dx; copies of what is shared agree in x and dx, as values take for granted."""
    h, border = 1e-5, program._copies[:, program._copies[0] >= 0]

    def slopes(x: np.ndarray) -> tuple[np.ndarray, scipy.sparse.csc_matrix]:
        gradient, numbers = program.first_derivatives(x)
        places = program.jacobian
        shape = program.count, program.size
        return gradient, scipy.sparse.csc_matrix((numbers, (places.rows, places.columns)), shape)

    (f1, g1), (f0, g0) = (program.values(x + s * h * dx) for s in (1.0, -1.0))
    gradient, jacobian = slopes(x)
    np.testing.assert_allclose(gradient @ dx, (f1 - f0) / (2 * h), rtol=1e-8)
    np.testing.assert_allclose(jacobian @ dx, (g1 - g0) / (2 * h), rtol=0.0, atol=1e-8)

    pull = [(lambda f, g: 2.0 * f + g.T @ multipliers)(*slopes(x + s * h * dx)) for s in (1.0, -1.0)]
    places = program.hessian
    numbers = program.lagrangian_hessian(x, 2.0, multipliers)
    hessian = scipy.sparse.csc_matrix((numbers, (places.rows, places.columns)), (program.size, program.size))
    own, wanted = hessian @ dx, (pull[0] - pull[1]) / (2 * h)
    others = np.setdiff1d(np.arange(program.size), border)
    np.testing.assert_allclose(own[others], wanted[others], rtol=0.0, atol=1e-6)
    for copies in border.T:
        once = np.unique(copies)
        np.testing.assert_allclose(own[once].sum(), wanted[once].sum(), atol=1e-6)
    without = program.lagrangian_hessian(x, 0.0, multipliers) + 2.0 * program.lagrangian_hessian(
        x, 1.0, 0.0 * multipliers
    )
    np.testing.assert_allclose(without, numbers, rtol=0.0, atol=1e-9)
