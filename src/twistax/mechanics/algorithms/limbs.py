"""Limbs of equal structure: subtrees that differ only in numbers. Their expressions are built once, as a map over the
limbs.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...expr import Concat, Constant, Expr, Reshaped, Stack, Vmap
from ...expr.lie import Pose
from ...expr.node import Shape
from ..bodies import SpatialInertia
from ..joints import Joint
from ..kinematic_tree import KinematicTree
from ..tree import Segment

#: A map over limbs with fewer segments takes as long to build as their expressions.
_FEWEST = 3

#: Attributes of joints that name them, or follow from their names.
_NAMES = {"name", "position", "velocity", "transform"}


class Limbs:
    """Subtrees of equal structure on segments of a mechanism.

    Attributes:
        roots: the index of the first segment of each.
        size: the number of segments in each.
        parents: the index of the segment on which each stands.
    """

    def __init__(self, mechanism: KinematicTree, roots: Sequence[int], size: int) -> None:
        self.roots, self.size = list(roots), size
        segments = mechanism.segments
        self.parents = [segments[root].before for root in roots]
        self._first = segments[roots[0] : roots[0] + size]
        self._freedoms = [
            slice(segments[root].freedoms[0], segments[root + size - 1].freedoms[-1] + 1) for root in roots
        ]
        self._varying = _Varying()
        places = range(size)
        self._numbers = [[_numbers_of(segments[root + k]) for root in roots] for k in places]
        self._parts = [{name: self._varying.part([n[name] for n in of]) for name in of[0]} for of in self._numbers]

    def places(self, limb: int) -> range:
        """The indices of the segments of a limb."""
        return range(self.roots[limb], self.roots[limb] + self.size)

    def rows(self, vector: Expr) -> Expr:
        """The entries of all limbs (limbs, k), of a vector with one entry for each degree of freedom."""
        return Stack(*(vector[at] for at in self._freedoms))

    def positions(self, positions: Sequence[Expr]) -> Expr:
        """The positions of all limbs (limbs, k), from those of all segments."""
        return Stack(*(Concat(*(positions[i] for i in self.places(k))) for k in range(len(self.roots))))

    def on_parents(self, values: Mapping[int, Expr]) -> Expr:
        """Values of the parent segments, a row for each limb."""
        return Stack(*(values[parent] for parent in self.parents))

    def pushes(self, pushes: Sequence[Expr | None]) -> list[Expr]:
        """The external wrenches (limbs, 6) on segments that have some."""
        return [
            Stack(*(pushes[root + k] for root in self.roots))
            for k in range(self.size)
            if pushes[self.roots[0] + k] is not None
        ]

    def map(self, function: Callable[..., Sequence[Expr]], batches: Sequence[Expr]) -> Mapped:
        """A function of one limb for all of them.

        Args:
            function: of the segments of a limb, by number, whose root has no segment before it, and whose freedoms and
                coordinates count from zero; and of its row of each batch. It returns arrays.
            batches: with one row for each limb.
        """
        shapes: list[Shape] = []

        def one(*elements: Expr) -> Expr:
            rows = iter(elements)
            segments = self._segments(next(rows) if self._varying.columns else Constant(np.zeros(0)))
            results = function(segments, *rows)
            shapes.extend(result.check_shape() for result in results)
            return Concat(*(_reshaped(result, (math.prod(result.shape),)) for result in results))

        numbers = [Constant(np.stack(self._varying.columns, axis=1))] if self._varying.columns else []
        return Mapped(Vmap(one, [*numbers, *batches]), shapes)

    def _segments(self, numbers: Expr) -> dict[int, Segment]:
        """The segments of one limb, with its row of the numbers in which limbs differ."""
        root, freedom, coordinate = self.roots[0], self._first[0].freedoms[0], self._first[0].coordinates.start
        result = dict[int, Segment]()
        for k, (segment, parts) in enumerate(zip(self._first, self._parts, strict=True)):
            known = {name: self._varying.value(part, numbers) for name, part in parts.items()}
            link, body = segment.link, segment.body
            mount = Pose(known["turn"], known["shift"])
            drive = link.drive
            if "rotor" in known:
                drive = dataclasses.replace(drive, armature=known["rotor"])
            if body is not None:
                inertia = known["inertia"]
                body = SpatialInertia(
                    mass=known["mass"], center_of_mass=known["center"], inertia=inertia, physical=False
                )
            at = segment.coordinates
            result[k] = Segment(
                link=_with(link, mount=mount, drive=drive),
                body=body,
                before=segment.before - root if k else -1,
                freedoms=tuple(i - freedom for i in segment.freedoms),
                coordinates=slice(at.start - coordinate, at.stop - coordinate),
            )
        return result


class Mapped(NamedTuple):
    """Results of a map over limbs.

    Attributes:
        rows: the entries of all results, a row for each limb.
        shapes: of the results.
    """

    rows: Expr
    shapes: list[Shape]

    def of(self, row: Expr, first: int = 0, last: int | None = None) -> list[Expr]:
        """Some of the results from a row."""
        ends = list(itertools.accumulate(map(math.prod, self.shapes), initial=0))
        places = range(len(self.shapes))[first:last]
        return [_reshaped(row[ends[k]] if not self.shapes[k] else row[ends[k] : ends[k + 1]], self.shapes[k]) for k in places]


def equal_limbs(mechanism: KinematicTree, pushes: Sequence[Expr | None]) -> list[Limbs]:
    """The largest limbs of equal structure, on whatever segments they stand.

    Args:
        pushes: the external wrench on each segment, or None.
    """
    segments = mechanism.segments
    ends = list(range(1, len(segments) + 1))
    for i in reversed(range(len(segments))):
        if segments[i].before >= 0:
            ends[segments[i].before] = max(ends[segments[i].before], ends[i])
    alike: dict[Hashable, list[int]] = {}
    kinds = [_structure(segment, push) for segment, push in zip(segments, pushes, strict=True)]
    for i, segment in enumerate(segments):
        size = ends[i] - i
        if segment.before >= 0 and size >= _FEWEST and None not in kinds[i : ends[i]]:
            before = tuple(segments[j].before - i for j in range(i + 1, ends[i]))
            alike.setdefault((size, before, *kinds[i : ends[i]]), []).append(i)
    taken, groups = set[int](), list[Limbs]()
    for key, roots in sorted(alike.items(), key=lambda item: -item[0][0]):
        free = [root for root in roots if root not in taken]
        if len(free) > 1:
            groups.append(Limbs(mechanism, free, key[0]))
            taken.update(i for root in free for i in range(root, root + key[0]))
    return groups


def others(mechanism: KinematicTree, groups: Sequence[Limbs]) -> dict[int, Segment]:
    """The segments that are on no limb of these, by index."""
    taken = {i for group in groups for k in range(len(group.roots)) for i in group.places(k)}
    return {i: segment for i, segment in enumerate(mechanism.segments) if i not in taken}


def _structure(segment: Segment, push: Expr | None) -> Hashable:
    """Equal for segments that differ only in numbers; None for one that is on no limb."""
    link, body = segment.link, segment.body
    joint = _of_joint(link.joint)
    moves = segment.freedoms and segment.coordinates is not None and link.mimic is None
    if joint is None or not moves or segment.inner_motion is not None:
        return None
    if not all(isinstance(number, Constant) for number in _numbers_of(segment).values()):
        return None
    return joint, body is None, link.drive.rotor is None, push is None


def _of_joint(joint: Joint) -> Hashable:
    """The class of a joint and its numbers; None where it has others than numbers."""
    facts: list[Hashable] = [type(joint)]
    for name, value in sorted(vars(joint).items()):
        if name in _NAMES:
            continue
        value = value.value if isinstance(value, Constant) else value
        if not isinstance(value, (int, float, str, tuple, np.ndarray)):
            return None
        facts.append((name, value.shape, value.tobytes()) if isinstance(value, np.ndarray) else (name, value))
    return tuple(facts)


def _numbers_of(segment: Segment) -> dict[str, Expr]:
    """The numbers in which limbs may differ."""
    link, body = segment.link, segment.body
    mount = link.mount.value if isinstance(link.mount, Constant) else None
    turn, shift = (link.mount, link.mount) if mount is None else (Constant(mount[:3, :3]), Constant(mount[:3, 3]))
    numbers = {"turn": turn, "shift": shift}
    if link.drive.rotor is not None:
        numbers["rotor"] = link.drive.rotor
    if body is not None:
        numbers |= {"mass": body.mass, "center": body.center_of_mass, "inertia": body.inertia}
    return numbers


class _Varying:
    """The entries of arrays that differ from limb to limb, as columns; equal and opposite columns are one."""

    def __init__(self) -> None:
        self.columns: list[NDArray[Any]] = []
        self._known: dict[bytes, int] = {}

    def part(self, arrays: Sequence[Constant]) -> Any:
        """An array: its entries are numbers, or the number of a column and its sign."""
        values = np.stack([array.value for array in arrays])
        entries: list[float | tuple[int, int]] = []
        for column in values.reshape(len(arrays), -1).T:
            column = column + 0.0
            entries.append(float(column[0]) if (column == column[0]).all() else self._column(column))
        return values.shape[1:], entries

    def _column(self, column: NDArray[Any]) -> tuple[int, int]:
        for sign in (1, -1):
            if (place := self._known.get((sign * column + 0.0).tobytes())) is not None:
                return place, sign
        self._known[column.tobytes()] = len(self.columns)
        self.columns.append(column)
        return len(self.columns) - 1, 1

    @staticmethod
    def value(part: Any, numbers: Expr) -> Expr:
        """The array of a limb, from its row of the columns."""
        shape, entries = part
        if not any(isinstance(entry, tuple) for entry in entries):
            return Constant(np.array(entries).reshape(shape))
        signed = [numbers[e[0]] * float(e[1]) if isinstance(e, tuple) else Constant(e) for e in entries]
        return signed[0] if not shape else _reshaped(Concat(*signed), shape)


def _with(record: Any, **changes: Any) -> Any:
    """A copy of a frozen record without its checks."""
    copied = object.__new__(type(record))
    copied.__dict__.update(record.__dict__ | changes)
    return copied


def _reshaped(value: Expr, shape: Shape) -> Expr:
    return value if value.shape == shape else Reshaped(value, shape)
