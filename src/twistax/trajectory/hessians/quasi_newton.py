"""Quasi-Newton Hessians of stages."""

from __future__ import annotations

import ctypes
import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray as Array

from ...solver.core import StageFunctions
from ...solver.kernels import Argument
from ...solver.transcription import Transcription
from ..transcription.evaluation import Evaluated

#: [NW] (6.26), r: an update is skipped if its denominator is a smaller fraction of the product of its vectors' lengths.
_LEAST = 1e-8
#: The ratio of the change of the objective by moves of one stage, initially, to its change by moves of all unknowns.
_FIRST = 0.1
_POINTER = ctypes.POINTER(ctypes.c_double)


class StageUpdates:
    """Symmetric rank-one updates, one block for each stage.

    Block k belongs to (x_k, u_k, p). Let s be a step of these unknowns, and y the change of the gradient of the stage's
    part of the Lagrangian, with the current multipliers. Then the block B becomes B + r r' / r's with r = y - B s. All
    vectors are in units of the unknowns. Blocks may be indefinite; the core corrects their inertia.
    Source: Nocedal and Wright, Numerical Optimization (2006), (6.24), [NW]; by blocks Bock and Plitt, A multiple
    shooting algorithm for direct solution of optimal control problems, IFAC Proceedings 17 (1984).

    Args:
        transcription: the problem.
        sizes: the sizes of all unknowns v.
        cost: the unit of the objective.

    Attributes:
        functions: the functions of the problem, with these Hessians.
    """

    def __init__(self, transcription: Transcription, sizes: Array, cost: float) -> None:
        self._transcription, stages = transcription, transcription.stages
        split = stages.variables - stages.parameters
        self._sizes = [np.concatenate([a, sizes[split:]]) for a in np.split(sizes[:split], stages.first[1:])]
        diagonals = [np.where(np.arange(n) < n - stages.parameters, _FIRST * cost, 0.0) for n in stages.columns]
        diagonals[-1][len(diagonals[-1]) - stages.parameters :] = _FIRST * cost
        self._blocks = [np.diag(d) for d in diagonals]
        self._last: _Place | None = None
        kind = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p, _POINTER, ctypes.c_double, *[_POINTER] * 4)
        self._error: BaseException | None = None
        self._callback = kind(self._called)
        address = ctypes.cast(self._callback, ctypes.c_void_p).value or 0
        self.functions: StageFunctions = dataclasses.replace(transcription.functions, hessians=address, owner=self)

    def check(self) -> None:
        """Raise the error that a callback of the core has recorded."""
        if self._error is not None:
            raise self._error
        self._transcription.check()

    def _called(self, _: object, z: Any, weight: float, lam: Any, y: Any, ye: Any, out: Any) -> int:
        stages = self._transcription.stages
        counts = (stages.points, *stages.row_counts)
        try:
            here, *multipliers = (np.array(_numbers(a, n)) for a, n in zip((z, lam, y, ye), counts))
            blocks = self._at(here, weight, multipliers)
            _numbers(out, stages.hessian_size)[:] = np.concatenate([block.ravel() for block in blocks])
        except BaseException as error:
            self._error = error
            return 1
        return 0

    def _at(self, z: Array, weight: float, multipliers: Sequence[Array]) -> list[Array]:
        """The blocks at a point, in the problem's units, after the update with the step to this point."""
        at = Evaluated(self._transcription, z)
        at.jacobians()
        here = _Place(z, *self._derivatives(at))
        if self._last is not None and not np.array_equal(self._last.z, z):
            steps, turns = zip(*self._steps(self._last.z, z))
            dynamics, *rest = self._by_stage(multipliers)
            now = here.gradients(weight, [dynamics, *rest])
            then = self._last.gradients(weight, [list(map(_turned_back, dynamics, turns[1:])) + dynamics[-1:], *rest])
            for block, size, step, turn, g, before in zip(self._blocks, self._sizes, steps, turns, now, then):
                _update(block, step / size, size * (_about_before(g, turn) - before) / weight)
        self._last = here
        return [weight * block / np.outer(size, size) for block, size in zip(self._blocks, self._sizes)]

    def _derivatives(self, at: Evaluated) -> tuple[list[Array], list[list[Array]]]:
        """For each stage, the gradient of its cost and the Jacobians of its defects, inequalities and equalities."""
        stages, slopes = self._transcription.stages, np.concatenate(self._transcription.cost_slopes)
        of_stages = np.split(at.gradient[: stages.variables - stages.parameters], stages.first[1:])
        kinds = ((at.F, stages.after), (at.Jh, stages.inequalities), (at.Je, stages.equalities))
        return [np.concatenate(parts) for parts in zip(of_stages, slopes)], [at.blocks(*kind) for kind in kinds]

    def _by_stage(self, multipliers: Sequence[Array]) -> list[list[Array]]:
        stages = self._transcription.stages
        counts = (stages.after, stages.inequalities, stages.equalities)
        return [np.split(values, np.cumsum(count)[:-1]) for values, count in zip(multipliers, counts)]

    def _steps(self, before: Array, after: Array) -> list[tuple[Array, _Turn | None]]:
        """For each stage the step between two points, and the Jacobians that transport tangent vectors."""
        stages, steps = self._transcription.stages, list[tuple[Array, _Turn | None]]()
        step = after - before
        shared = step[stages.points - stages.parameters :]
        for phase, first in zip(self._transcription.phases, self._transcription.first):
            begins = stages.first_point[first : first + len(phase.controls)]
            old, new = (z[begins[:, None] + np.arange(phase.point)] for z in (before, after))
            arguments = {Argument.Z: np.zeros((len(old), phase.n)), Argument.BASE: new, Argument.TARGET: old}
            tangents = phase.kernels.gap.kernels[0](len(old), phase.n, arguments)
            turns: list[_Turn | None] = [None] * len(old)
            if (turn := phase.kernels.turn) is not None:
                sides = (turn(len(old), phase.n**2, {Argument.Z: side * tangents}) for side in (1.0, -1.0))
                turns = [_Turn(*both) for both in zip(*(a.reshape(-1, phase.n, phase.n) for a in sides))]
            for tangent, turn_of, a, count in zip(tangents, turns, begins + phase.point, phase.controls):
                steps.append((np.concatenate([tangent, step[a : a + count], shared]), turn_of))
        return steps


class _Turn(NamedTuple):
    """The left and the right Jacobian of the exponential map at a step."""

    left: Array
    right: Array


def _about_before(gradient: Array, turn: _Turn | None) -> Array:
    """A gradient with respect to the node before a step, from the gradient with respect to the node after it."""
    if turn is None:
        return gradient
    n = len(turn.right)
    return np.concatenate([turn.right.T @ gradient[:n], gradient[n:]])


def _turned_back(multipliers: Array, turn: _Turn | None) -> Array:
    """Multipliers of a logarithm about the node before a step, from those about the node after it."""
    return multipliers if turn is None else np.linalg.solve(turn.left.T, multipliers)


class _Place(NamedTuple):
    """A point, with the derivatives of each stage there."""

    z: Array
    cost: list[Array]
    slopes: list[list[Array]]

    def gradients(self, weight: float, multipliers: list[list[Array]]) -> list[Array]:
        """The gradient of each stage's part of the Lagrangian."""
        gradients = [weight * gradient for gradient in self.cost]
        for slopes, values in zip(self.slopes, multipliers):
            gradients = [g + matrix.T @ a for g, matrix, a in zip(gradients, slopes, values)]
        return gradients


def _update(block: Array, step: Array, change: Array) -> None:
    left = change - block @ step
    product = left @ step
    if abs(product) > _LEAST * np.linalg.norm(left) * np.linalg.norm(step):
        block += np.outer(left, left) / product


def _numbers(pointer: Any, count: int) -> Array:
    return np.ctypeslib.as_array(pointer, (count,)) if count else np.zeros(0)
