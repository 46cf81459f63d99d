"""What each row of a residual vector is: its name, whether it is an equality, and where in an interval it is asked."""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Mapping, Sequence
from math import prod

import numpy as np
from numpy import ndarray as Array

from ..expr import Constraint, Control, Equality, Leaf, State, Time, leaves_of
from ..lowering import Dynamics

__all__ = ["Bound", "PathRows", "Reads", "bounds_of", "describe_path", "names_of"]


class Reads(enum.Enum):
    """What a constraint depends on, and so at which points of an interval with held controls it has to be asked."""

    CONTROL = "controls alone: once an interval"
    STATE = "states and time: at every point, shared ends once"
    BOTH = "states and controls: at every point, shared ends from both sides"


@dataclasses.dataclass(frozen=True)
class Bound:
    """One finite side of a leaf's box: sign * (value[entry] - limit) <= 0."""

    leaf: str
    entry: int
    sign: float
    limit: float
    name: str
    reads: Reads


@dataclasses.dataclass(frozen=True)
class PathRows:
    """The rows of the path function: the system's inequalities, its equalities, then the boxes of the leaves.

    Attributes:
        names, equality, reads: of every row.
        states: the states every row reads.
        bounds: the boxes, as the last rows.
    """

    names: tuple[str, ...]
    equality: Array
    reads: tuple[Reads, ...]
    states: tuple[frozenset[str], ...]
    bounds: tuple[Bound, ...]

    def asked(self, intervals: int, substeps: int) -> Array:
        """Where the rows are asked: bool (intervals, substeps + 1, rows). The last point of an interval is its end."""
        mask = np.zeros((intervals, substeps + 1, len(self.names)), bool)
        for row, reads in enumerate(self.reads):
            if reads is Reads.CONTROL:
                mask[:, 0, row] = True
            elif reads is Reads.STATE:
                mask[:, :-1, row] = True
                mask[-1, -1, row] = True
            else:
                mask[:, :, row] = True
        return mask

    def decided(self, intervals: int, substeps: int, fixed: frozenset[str]) -> Array:
        """Rows that no unknown can change, because the start fixes all they read: a mask like that of `asked`.

        Args:
            fixed: the states whose start is given in full.
        """
        mask = np.zeros((intervals, substeps + 1, len(self.names)), bool)
        for row, (reads, states) in enumerate(zip(self.reads, self.states)):
            mask[0, 0, row] = reads is Reads.STATE and states <= fixed
        return mask


def describe_path(dynamics: Dynamics) -> PathRows:
    """The rows of a compiled system, in the order `dynamics.constraints` has them, and its leaves' boxes."""
    residuals = {name: constraint.residual() for name, constraint in dynamics.system.constraints.items()}
    reads: list[Reads] = []
    states: list[frozenset[str]] = []
    for equality in (False, True):
        for name, constraint in dynamics.system.constraints.items():
            if isinstance(constraint, Equality) == equality:
                entries, leaves = prod(residuals[name].shape), list(leaves_of(residuals[name].canonicalize()))
                reads += [_reads(leaves)] * entries
                states += [frozenset(leaf.name for leaf in leaves if isinstance(leaf, State))] * entries
    names = [*dynamics._functions.constraint_names["inequality"], *dynamics._functions.constraint_names["equality"]]
    bounds = tuple(bounds_of((*dynamics.states, *dynamics.controls)))
    equality_rows = np.zeros(len(names) + len(bounds), bool)
    equality_rows[len(dynamics._functions.constraint_names["inequality"]) : len(names)] = True
    return PathRows(
        names=(*names, *(b.name for b in bounds)),
        equality=equality_rows,
        reads=(*reads, *(b.reads for b in bounds)),
        states=(*states, *(frozenset([b.leaf]) for b in bounds)),
        bounds=bounds,
    )


def _reads(leaves: Sequence[Leaf]) -> Reads:
    kinds = [type(leaf) for leaf in leaves]
    if Control not in kinds:
        return Reads.STATE
    return Reads.BOTH if State in kinds or Time in kinds else Reads.CONTROL


def bounds_of(leaves: Sequence[State | Control]) -> list[Bound]:
    """Every finite side of the leaves' boxes."""
    found = []
    for leaf in leaves:
        reads = Reads.CONTROL if isinstance(leaf, Control) else Reads.STATE
        for sign, symbol, limits in ((1.0, "<=", leaf.max), (-1.0, ">=", leaf.min)):
            if limits is None:
                continue
            for entry, limit in enumerate(limits.ravel()):
                if np.isfinite(limit):
                    place = f"{leaf.name}[{entry}]" if leaf.shape else leaf.name
                    found.append(Bound(leaf.name, entry, sign, float(limit), f"{place} {symbol} {limit:g}", reads))
    return found


def names_of(constraints: Mapping[str, Constraint]) -> list[str]:
    """A name for every entry of named constraints."""
    return [
        f"{name}[{i}]" if constraint.shape else name
        for name, constraint in constraints.items()
        for i in range(prod(constraint.shape))
    ]


def where(substeps: int, interval: int, point: int) -> str:
    """Words for a point of an interval."""
    if point == 0:
        return f"at node {interval}"
    if point == substeps:
        return f"at node {interval + 1}"
    return f"between nodes {interval} and {interval + 1}"
