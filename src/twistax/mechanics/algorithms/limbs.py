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

from ...expr import Concat, Constant, Expr, Reshaped, Stack, Vmap, canonicalize_all, leaves_of
from ...expr.lie import Pose
from ...expr.node import Shape
from ..bodies import SpatialInertia
from ..joints import Joint
from ..kinematic_tree import KinematicTree
from ..tree import Segment

#: A map over limbs with fewer segments takes as long to build as their expressions.
_FEWEST = 2

#: The numbers of a body.
_BODY = ("mass", "center_of_mass", "inertia", "matrix")

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
        roots_of_place = [[root + k for root in roots] for k in range(size)]
        numbers = [[_numbers_of(segments[i]) for i in of] for of in roots_of_place]
        folded = iter(canonicalize_all([value for of in numbers for known in of for value in known.values()]))
        known = [[{name: next(folded) for name in n} for n in of] for of in numbers]
        self._parts = [{name: self._varying.part([n[name] for n in of]) for name in of[0]} for of in known]

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
        return Mapped(Vmap(one, [*numbers, *batches]).of_parts(), shapes)

    def _segments(self, numbers: Expr) -> dict[int, Segment]:
        """The segments of one limb, with its row of the numbers in which limbs differ."""
        root, freedom, coordinate = self.roots[0], self._first[0].freedoms[0], coordinates_of(self._first[0]).start
        pool = Concat(numbers, Constant(np.array(self._varying.common))) if self._varying.columns else numbers
        result = dict[int, Segment]()
        for k, (segment, parts) in enumerate(zip(self._first, self._parts, strict=True)):
            known = {name: part if isinstance(part, Expr) else part.value(pool) for name, part in parts.items()}
            link, at = segment.link, coordinates_of(segment)
            mount: Expr = link.mount
            if not isinstance(parts["turn"], Expr) or not isinstance(parts["shift"], Expr):
                mount = Pose(known["turn"], known["shift"])
            drive = _with(link.drive, armature=known["rotor"]) if "rotor" in known else link.drive
            result[k] = _Segment(
                link=_with(link, mount=mount, drive=drive),
                body=None if segment.body is None else _Body({name: known[name] for name in _BODY}),
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
        return [
            _reshaped(row[ends[k]] if not self.shapes[k] else row[ends[k] : ends[k + 1]], self.shapes[k])
            for k in places
        ]


def equal_limbs(mechanism: KinematicTree, pushes: Sequence[Expr | None]) -> list[Limbs]:
    """The largest limbs of equal structure, on whatever segments they stand.

    Args:
        pushes: the external wrench on each segment, or None. Segments with one are on no limb, so that the order of
            controls does not depend on the structure.
    """
    segments = mechanism.segments
    ends = list(range(1, len(segments) + 1))
    for i in reversed(range(len(segments))):
        if segments[i].before >= 0:
            ends[segments[i].before] = max(ends[segments[i].before], ends[i])
    roots_by_structure: dict[tuple[Any, ...], list[int]] = {}
    kinds = [_structure(segment, push) for segment, push in zip(segments, pushes, strict=True)]
    for i, segment in enumerate(segments):
        size = ends[i] - i
        if segment.before >= 0 and size >= _FEWEST and None not in kinds[i : ends[i]]:
            before = tuple(segments[j].before - i for j in range(i + 1, ends[i]))
            roots_by_structure.setdefault((size, before, *kinds[i : ends[i]]), []).append(i)
    taken, groups = set[int](), list[Limbs]()
    for key, roots in sorted(roots_by_structure.items(), key=lambda item: -item[0][0]):
        free = [root for root in roots if root not in taken]
        if len(free) > 1:
            groups.append(Limbs(mechanism, free, key[0]))
            taken.update(i for root in free for i in range(root, root + key[0]))
    return groups


def others(mechanism: KinematicTree, groups: Sequence[Limbs]) -> dict[int, Segment]:
    """The segments that are on no limb of these, by index."""
    taken = {i for group in groups for k in range(len(group.roots)) for i in group.places(k)}
    return {i: segment for i, segment in enumerate(mechanism.segments) if i not in taken}


def coordinates_of(segment: Segment) -> slice:
    """The coordinates of a segment on a limb, whose joint is on no group."""
    assert segment.coordinates is not None
    return segment.coordinates


def _structure(segment: Segment, push: Expr | None) -> Hashable:
    """Equal for segments that differ only in numbers; None for one that is on no limb."""
    link, body = segment.link, segment.body
    joint = _of_joint(link.joint)
    is_free = segment.freedoms and segment.coordinates is not None and link.mimic is None
    if joint is None or not is_free or segment.inner_motion is not None or push is not None:
        return None
    if any(not isinstance(leaf, Constant) for leaf in leaves_of(*_numbers_of(segment).values())):
        return None
    return joint, body is None, link.drive.rotor is None


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
    numbers: dict[str, Expr] = {"turn": link.mount[:3, :3], "shift": link.mount[:3, 3]}
    if link.drive.rotor is not None:
        numbers["rotor"] = link.drive.rotor
    if body is not None:
        numbers |= {name: getattr(body, name) for name in _BODY}
    return numbers


class _Varying:
    """The entries of arrays that differ from limb to limb, as columns; equal and opposite columns are one."""

    def __init__(self) -> None:
        self.columns: list[NDArray[Any]] = []
        #: Other entries of these arrays, which all limbs have in common.
        self.common: list[float] = []
        self._known: dict[bytes, int] = {}

    def part(self, arrays: Sequence[Constant]) -> Constant | _Part:
        """An array of all limbs."""
        values = np.stack([array.value for array in arrays]) + 0.0
        if (values == values[0]).all():
            return arrays[0]
        places, signs = list[int](), list[float]()
        for column in values.reshape(len(arrays), -1).T:
            sign = 1.0
            if (column == column[0]).all():
                self.common.append(float(column[0]))
                place = -len(self.common)
            else:
                place, sign = self._column(column)
            places.append(place)
            signs.append(sign)
        return _Part(self, values.shape[1:], places, np.array(signs))

    def _column(self, column: NDArray[Any]) -> tuple[int, float]:
        for sign in (1.0, -1.0):
            if (place := self._known.get((sign * column + 0.0).tobytes())) is not None:
                return place, sign
        self._known[column.tobytes()] = len(self.columns)
        self.columns.append(column)
        return len(self.columns) - 1, 1.0


@dataclasses.dataclass(frozen=True)
class _Part:
    """An array with entries that differ from limb to limb.

    Attributes:
        places: of its entries, in the columns, or below zero in the common numbers.
        signs: by which they are multiplied.
    """

    varying: _Varying
    shape: Shape
    places: Sequence[int]
    signs: NDArray[np.float64]

    def value(self, pool: Expr) -> Expr:
        """The array of a limb, from its row of the columns, with the common numbers after it."""
        count = len(self.varying.columns)
        entries: Expr = pool[np.array([place if place >= 0 else count - 1 - place for place in self.places])]
        if not (self.signs == 1.0).all():
            entries = Constant(self.signs) * entries
        return entries[0] if not self.shape else _reshaped(entries, self.shape)


class _Segment(Segment):
    """A segment of one limb, in which no mass moves."""

    inner_motion: Any = None


class _Body(SpatialInertia):
    """A body of one limb."""

    matrix: Any = None

    def __init__(self, numbers: Mapping[str, Expr]) -> None:
        self.__dict__.update(numbers)


def _with(record: Any, **changes: Any) -> Any:
    """A copy of a frozen record without its checks."""
    copied = object.__new__(type(record))
    copied.__dict__.update(record.__dict__ | changes)
    return copied


def _reshaped(value: Expr, shape: Shape) -> Expr:
    return value if value.shape == shape else Reshaped(value, shape)
