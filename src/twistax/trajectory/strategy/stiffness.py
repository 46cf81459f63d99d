"""Dynamics too stiff for explicit steps, and the implicit transcription in place of them."""

from __future__ import annotations

import numpy as np
from numpy import ndarray as Array

from ...integrators import tableaus
from ...solver.kernels import Argument
from ..transcription.methods import Collocation
from ..transcription.points import Given, Point
from ..transcription.staged import Staged

#: The product of an eigenvalue of the rates and a step above which RK4 is not stable.
#: Source: Hairer and Wanner, Solving ordinary differential equations II (1996), section IV.2.
LARGEST = 2.8
#: The transcription that is tried then: it damps what is fast.
IMPLICIT, IMPLICIT_NAME = Collocation(tableaus.RADAU_IIA5), "Collocation(tx.tableaus.RADAU_IIA5)"


#: The factor above which a mode that does not grow counts as amplified by a step.
_AMPLIFIES = 1.2


def stiffness(staged: Staged, point: Point, instance: Given) -> float:
    """The largest product of an eigenvalue of the rates' Jacobian, at a node, and a substep; of explicit phases."""
    explicit = [z for part, z in zip(staged.parts, _modes(staged, point, instance)) if not part.phase.method.implicit]
    return max((float(np.abs(z).max(initial=0.0)) for z in explicit), default=0.0)


def amplification(staged: Staged, point: Point, instance: Given) -> list[Array]:
    r"""For each phase (intervals,) the factor by which a substep amplifies a mode that does not grow; 1 if it is small.

    A Runge-Kutta method multiplies a mode with eigenvalue $\lambda$ by $R(z) = \det(I - z A + z 1 b^T) / \det(I - z A)$
    with $z = \lambda h$, the equation by $e^z$. Where $|R| > \max(1, |e^z|)$ the optimum of a mesh avoids what moves
    the mode: its trajectory may follow the equation, and yet be no optimum of it.
    Source: Hairer and Wanner, Solving ordinary differential equations II (1996), section IV.3.
    """
    amplified = []
    for part, z in zip(staged.parts, _modes(staged, point, instance)):
        a, b = np.asarray(part.phase.method.a, float), np.asarray(part.phase.method.b, float)
        of_stages = np.eye(len(b)) - z[..., None, None] * a
        grown = np.linalg.det(of_stages + z[..., None, None] * b) / np.linalg.det(of_stages)
        factors = (np.abs(grown) / np.maximum(1.0, np.abs(np.exp(z)))).max(axis=1, initial=1.0)
        amplified.append(np.where(factors > _AMPLIFIES, factors, 1.0))
    return amplified


def _modes(staged: Staged, point: Point, instance: Given) -> list[Array]:
    """For each phase (intervals, n) eigenvalues of the rates' Jacobian at the first node times a substep, or zero."""
    staged.set_given(instance)
    data, every, border = staged.numbers.vector(instance), list[Array](), np.asarray(point.border)
    for part, segment in zip(staged.parts, staged.transcribed.segments):
        phase, here, n, size = part.phase, segment.of(point), part.shooting.n, part.shooting.size
        count = phase.intervals
        arguments = {
            Argument.Z: np.concatenate([np.zeros((count, n)), here.us, np.tile(border, (count, 1))], axis=1),
            Argument.SHARE: phase.starts[:, None],
            Argument.BASE: part.point.joined(here.xs, 1)[:-1],
            Argument.DATA: data[None],
        }
        slopes = phase.kernels.rate.kernels[1](count, n * size, arguments).reshape(count, n, size)[:, :, :n]
        scaled = slopes * (phase.widths / phase.method.substeps)[:, None, None]
        known = np.isfinite(scaled).all(axis=(1, 2))
        modes = np.zeros((count, n), complex)
        modes[known] = np.linalg.eigvals(scaled[known])
        every.append(modes)
    return every
