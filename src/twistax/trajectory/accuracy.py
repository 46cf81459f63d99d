"""What is looked at once a search has ended: the error of the mesh, limits between nodes, and rows without slope.

Every interval is integrated closely again from its planned start, with the planned controls. It ends a tangent g_k away
from the planned end. With y_k the multipliers of the dynamics, the objective J of a mesh that follows the equations is,
to first order,

    J + sum_k y_k . g_k + (cost along the close integration - cost as planned).

Source: Becker and Rannacher, Acta Numerica 10 (2001), pp. 1-102, errors weighted by the dual solution.

A row has a slope if a move of all unknowns changes it by as much as its multiplier is worth. Its multiplier times
that change, over the change of the objective, is of order one where it has.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from numpy import ndarray as Array

from .close_look import CloseLook
from .outcome import Outcome
from .sizes import largest_values
from .staged import Staged
from .stiff import amplification
from .transcribed import Closely, Given
from .watch import AT_OPTIMUM, Status

#: The error of a mesh that SOLVED allows, unless another is asked for.
MESH = 1e-2
#: Multipliers beyond this, in scales of moves, are of rows without slope.
_RUN_AWAY = 1e8
#: The length of a small move, in sizes of the unknowns.
_SMALL = 1e-3


@dataclasses.dataclass(frozen=True)
class Exceeded:
    """A limit that does not hold between nodes.

    Attributes:
        by: how far it is exceeded, in its own unit.
        share: the same in its scale; limits hold within `tolerance` of that at the nodes.
        place: between which nodes.
    """

    by: float
    share: float
    place: str


@dataclasses.dataclass(frozen=True)
class Accuracy:
    r"""How closely a result follows the differential equations, by a close integration of each interval.

    Interval k, integrated from its planned start, ends a tangent $g_k$ from its planned end. With costates $y_k$ the
    objective of a mesh without error is $J + \sum_k y_k \cdot g_k + \Delta$ to first order, with $\Delta$ the error
    of the running cost. Source: Becker and Rannacher, Acta Numerica 10 (2001), pp. 1-102.

    Example: `problem.solve().accuracy.error`.

    Attributes:
        intervals: of each phase (intervals,), the largest entry of $g_k$ in scales of the states, without unit.
        change: by how much the objective would change on a mesh without error, to first order, in its unit.
        share: the size of that change over `size`.
        size: the objective, or where that is larger what its states are worth: the largest costate times its state.
        amplified: of each phase (intervals,), the factor by which a substep multiplies a mode of the equations that
            does not grow; 1 where the method is stable.
        exceeded: name -> a limit that is exceeded between nodes, with `by` how much in its unit, `share` of its scale,
            and `place`; the largest share first.
        tolerance: the `mesh_tolerance` that was asked for.
        middles: of each phase, states by name (intervals, ...) halfway through the close integration.
        places: of each phase, what it is called in a message.
    """

    intervals: tuple[Array, ...]
    change: float
    share: float
    size: float
    amplified: tuple[Array, ...]
    exceeded: dict[str, Exceeded]
    tolerance: float
    middles: tuple[dict[str, Array], ...] = dataclasses.field(repr=False)
    places: tuple[str, ...] = dataclasses.field(repr=False)

    @property
    def error(self) -> float:
        """The largest of all intervals."""
        return float(np.concatenate(self.intervals).max(initial=0.0))

    @property
    def place(self) -> str:
        """Where that is."""
        return self._largest(self.intervals)

    @property
    def factor(self) -> float:
        """The largest factor of a mode that a step amplifies; 1 if there is none."""
        return float(np.concatenate(self.amplified).max(initial=1.0))

    @property
    def unstable_place(self) -> str:
        """Where that is."""
        return self._largest(self.amplified)

    @property
    def coarse(self) -> bool:
        """Whether the mesh is too coarse for what was asked."""
        follows = self.error <= self.tolerance and self.share <= self.tolerance
        return not (follows and (self.factor <= 1.0 or np.isinf(self.tolerance)))

    def _largest(self, numbers: Sequence[Array]) -> str:
        phase = int(np.argmax([own.max(initial=0.0) for own in numbers]))
        stage = int(numbers[phase].argmax())
        return f"between nodes {stage} and {stage + 1}{self.places[phase]}"


class Flat(NamedTuple):
    """A row without slope, and its multiplier in scales of moves."""

    name: str
    place: str
    multiplier: float


class Judge:
    """Looks at where searches end, and says what that makes of their status.

    Args:
        close_look: integrates closely.
    """

    def __init__(self, close_look: CloseLook, staged: Staged) -> None:
        self._close_look, self._staged, self._shooting = close_look, staged, staged.transcribed
        shooting = self._shooting
        cones = [shooting.named(own, name) for own in shooting.segments for name in own.shooting.path.cones]
        #: Rows |a|^2 <= b^2 that stand for |a| <= b: their multipliers go like 1 / b as b goes to zero.
        self._cones = np.isin(np.asarray(shooting.names, str), cones)

    def judged(self, outcome: Outcome, given: Given, mesh_tolerance: float, tolerance: float) -> Outcome:
        """The outcome with its accuracy, and with the status that this gives it.

        Args:
            mesh_tolerance: the largest error of the mesh of a status that says that the problem is solved.
            tolerance: limits that are exceeded by more, in their scales, are named.
        """
        ended_well = outcome.status in AT_OPTIMUM
        if outcome.status is Status.NON_FINITE or not (ended_well or _is_finite((outcome.point, outcome.values))):
            return outcome
        z = self._staged.flat(outcome.point)
        amplified = amplification(self._staged, outcome.point, given)
        accuracy = self._accuracy(self._close_look.at(z, given), outcome, mesh_tolerance, tolerance, amplified)
        outcome = outcome._replace(accuracy=accuracy, flat=self._flat(z, outcome))
        if not ended_well:
            return outcome
        if outcome.flat is not None:
            return outcome._replace(status=Status.DEGENERATE)
        return outcome._replace(status=Status.COARSE) if accuracy.coarse else outcome

    def _flat(self, z: Array, outcome: Outcome) -> Flat | None:
        """The row whose multiplier is largest, if that has run away."""
        weights, scales = np.abs(outcome.rows), outcome.scales
        if not weights.any():
            return None
        step, sizes = self._staged.step(scales.d, scales.u, scales.border), np.zeros_like(weights)
        for length, seen in ((_SMALL, 1.0), (1.0, ~self._cones)):  # a whole move shows what is flat to several orders
            look = self._close_look.changes(z, step, length)
            sizes = np.maximum(sizes, seen * weights * look.rows / look.cost if look.cost > 0.0 else 0.0)
        row = int(sizes.argmax())
        if not sizes[row] > _RUN_AWAY:
            return None
        return Flat(str(self._shooting.names[row]), self._shooting.places[row], float(sizes[row]))

    def _accuracy(
        self,
        phases: Sequence[Closely],
        outcome: Outcome,
        mesh_tolerance: float,
        tolerance: float,
        amplified: Sequence[Array],
    ) -> Accuracy:
        shooting, scales = self._shooting, outcome.scales
        places = shooting.phase_places
        intervals, change, exceeded, worth = [], -outcome.cost, dict[str, Exceeded](), 0.0
        for closely, segment, place in zip(phases, shooting.segments, places):
            own = segment.shooting
            sizes = np.asarray(scales.d)[segment.nodes, : own.n][1:]
            intervals.append(np.abs(closely.gaps / sizes).max(axis=1, initial=0.0))
            change += float(closely.cost + (outcome.dynamics[segment.stages, : own.n] * closely.gaps).sum())
            known = largest_values(own, segment.of(outcome.point))
            spread = np.where(known > 0.0, np.minimum(known, sizes.max(axis=0)), sizes.max(axis=0))
            costates = outcome.dynamics[segment.stages, : own.n]
            worth = max(worth, float(np.abs(costates * spread).max(initial=0.0)))
            rows = own.row_scales(shooting.rows_of(segment, np.asarray(scales.rows)))
            shares = closely.rows / np.where(np.isinf(rows), rows.min(axis=0), rows)
            for name, found in _exceeded(own, closely, shares, tolerance, place).items():
                exceeded[shooting.named(segment, name)] = found
        order = sorted(exceeded, key=lambda name: -exceeded[name].share)
        size = max(abs(outcome.cost), min(float(scales.cost), worth)) or 1.0
        return Accuracy(
            intervals=tuple(intervals),
            change=change,
            share=abs(change) / size,
            size=size,
            amplified=tuple(amplified),
            exceeded={name: exceeded[name] for name in order},
            tolerance=mesh_tolerance,
            middles=tuple(closely.middles for closely in phases),
            places=tuple(places),
        )


def _exceeded(own: Any, closely: Closely, shares: Array, tolerance: float, place: str) -> dict[str, Exceeded]:
    """The limits of a phase that do not hold between nodes, each where it is exceeded most."""
    found = dict[str, Exceeded]()
    for row in np.flatnonzero(shares.max(axis=0, initial=0.0) > tolerance):
        name, stage = own.path.names[row], int(shares[:, row].argmax())
        share = float(shares[stage, row])
        if name not in found or share > found[name].share:
            by = float(closely.rows[stage, row])
            found[name] = Exceeded(by, share, f"between nodes {stage} and {stage + 1}{place}")
    return found


def _is_finite(tree: Any) -> bool:
    return all(np.isfinite(np.asarray(a)).all() for a in jax.tree.leaves(tree))
