"""Dynamics that are too stiff for explicit steps, and the implicit transcription that replaces explicit steps."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from ...integrators import tableaus
from ...solver.kernels import Argument
from ...solver.transcription import Scheme
from ..transcription.iterate import Instance, Iterate
from ..transcription.methods import Collocation
from ..transcription.staged import Staged

#: The product of an eigenvalue of the rates and a step above which RK4 is not stable.
#: Source: Hairer and Wanner, Solving ordinary differential equations II (1996), section IV.2.
LARGEST = 2.8
#: The transcription that is tried in that case; it damps fast modes.
IMPLICIT, IMPLICIT_NAME = Collocation(tableaus.RADAU_IIA5), "Collocation(tx.tableaus.RADAU_IIA5)"


#: The factor above which a mode that does not grow counts as amplified by a step.
_AMPLIFIES = 1.2
#: Radii and angles at which stability functions are evaluated.
_RADII, _ANGLES = np.linspace(0.02, 5.0, 250), 181


def stiffness(staged: Staged, point: Iterate, instance: Instance) -> float:
    """The largest product of an eigenvalue of the rates' Jacobian at a node and the substep, over all phases with
    explicit steps.
    """
    explicit = [z for part, z in zip(staged.parts, _modes(staged, point, instance)) if not part.phase.method.implicit]
    return max((float(np.abs(z).max(initial=0.0)) for z in explicit), default=0.0)


def amplification(staged: Staged, point: Iterate, instance: Instance) -> list[Array]:
    r"""For each phase (intervals,) the factor by which a substep amplifies a mode that does not grow in the exact
    solution; 1 if the product of eigenvalue and substep is small.

    A Runge-Kutta method multiplies a mode with eigenvalue $\lambda$ by $R(z) = \det(I - z A + z 1 b^T) / \det(I - z A)$
    with $z = \lambda h$; the exact solution multiplies it by $e^z$. If $|R| > \max(1, |e^z|)$, the optimiser avoids
    controls that excite the mode, so the trajectory may satisfy the equation without being optimal.
    Source: Hairer and Wanner, Solving ordinary differential equations II (1996), section IV.3.
    """
    amplified = []
    functions = [_stability_function(part.phase.method) for part in staged.parts]
    for function, z in zip(functions, _modes(staged, point, instance, [f.radius for f in functions])):
        factors = function.factors(z).max(axis=1, initial=1.0)
        amplified.append(np.where(factors > _AMPLIFIES, factors, 1.0))
    return amplified


class _StabilityFunction(NamedTuple):
    r"""The stability function $R(z)$ of a method, a quotient of two polynomials.

    Attributes:
        above, below: the coefficients of both, the highest power first.
        radius: within this radius, the method amplifies no mode by more than `_AMPLIFIES`.
    """

    above: Array
    below: Array
    radius: float = 0.0

    def factors(self, z: Array) -> Array:
        r"""$|R(z)| / \max(1, |e^z|)$."""
        grown = np.polyval(self.above, z) / np.polyval(self.below, z)
        return np.asarray(np.abs(grown) / np.maximum(1.0, np.exp(z.real)))


def _stability_function(method: Scheme) -> _StabilityFunction:
    a, b = (np.ascontiguousarray(numbers, float) for numbers in (method.a, method.b))
    return _stability_function_of(a.tobytes(), b.tobytes())


@functools.lru_cache(64)
@np.errstate(all="ignore")
def _stability_function_of(a_bytes: bytes, b_bytes: bytes) -> _StabilityFunction:
    b = np.frombuffer(b_bytes)
    a = np.frombuffer(a_bytes).reshape(len(b), len(b))
    function = _StabilityFunction(np.poly(a - b)[::-1], np.poly(a)[::-1])
    # The moduli of R in the left half plane, and of R e^-z in the right one, are largest on the boundary: the imaginary
    # axis and the circle.
    angles = np.exp(1j * np.linspace(0.0, np.pi, _ANGLES))
    factors = function.factors(_RADII[:, None] * np.append(angles, 1j))
    bad = ~(factors < 1.0 + 0.5 * (_AMPLIFIES - 1.0)).all(axis=1)
    return function._replace(radius=float(_RADII[max(int(bad.argmax()) - 1, 0)] if bad.any() else _RADII[-1]))


def _modes(staged: Staged, point: Iterate, instance: Instance, least: Sequence[float] | None = None) -> list[Array]:
    """For each phase (intervals, n) the products of substep and eigenvalues of the rates' Jacobian at the first node,
    or zero.

    Args:
        least: for each phase, the radius within which eigenvalues may be replaced by zero.
    """
    staged.set_instance(instance)
    data, every = staged.numbers.vector(instance), list[Array]()
    shared = np.asarray(point.border)[staged.border.unknown]
    for part, segment, radius in zip(staged.parts, staged.transcribed.segments, least or [0.0] * len(staged.parts)):
        phase, here, n, size = part.phase, segment.of(point), part.shooting.n, part.shooting.size
        count = phase.intervals
        arguments = {
            Argument.Z: np.concatenate([np.zeros((count, n)), here.us, np.tile(shared, (count, 1))], axis=1),
            Argument.SHARE: phase.starts[:, None],
            Argument.BASE: part.point.joined(here.xs, 1)[:-1],
            Argument.DATA: data[None],
            Argument.PHASE: data[None, staged.numbers.of_phase(segment.number)],
        }
        slopes = phase.kernels.rate.kernels[1](count, n * size, arguments).reshape(count, n, size)[:, :, :n]
        scaled = slopes * (phase.widths / phase.method.substeps)[:, None, None]
        largest = np.abs(scaled).sum(axis=2).max(axis=1, initial=0.0)  # no eigenvalue is larger
        known = np.isfinite(largest) & (largest > radius)
        modes = np.zeros((count, n), complex)
        modes[known] = np.linalg.eigvals(scaled[known])
        every.append(modes)
    return every
