"""Entries of vectors by name: "throttle", "V", "V[3]", "V[3:6]"."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from math import prod

from ..checks import listed, short
from ..errors import InputError
from ..groups import Product

_ENTRY = re.compile(r"(?P<name>.*?)(\[(?P<first>-?\d*)(?P<colon>:?)(?P<last>-?\d*)\])?")


def labels(sizes: Mapping[str, tuple[int, ...]]) -> tuple[str, ...]:
    """A name for every entry, read row by row: "h" for a scalar, "V[0]", "V[1]", ... for others."""
    return tuple(f"{name}[{i}]" if shape else name for name, shape in sizes.items() for i in range(prod(shape)))


def tangent_shapes(group: Product) -> dict[str, tuple[int, ...]]:
    """The shapes of the tangents of states, in the form that `labels` requires: () for a scalar."""
    return {name: () if factor.shape == () else (factor.dimension,) for name, factor in group.factors.items()}


def entry(place: str, wanted: object, shapes: Mapping[str, tuple[int, ...]]) -> tuple[str, range]:
    """The requested name, and which of its entries, read row by row, are requested.

    Raises InputError for an object that is not a text, an unknown name, or entries that do not exist.
    """
    if not isinstance(wanted, str):
        raise InputError(f"{place} expects names such as 'V', 'V[3]' or 'V[3:6]', got {short(wanted)}")
    match = _ENTRY.fullmatch(wanted)
    name = wanted if match is None or wanted in shapes else match["name"]
    if name not in shapes:
        raise InputError(f"{place} names {wanted!r}, but expects one of {listed(shapes, name)}")
    size = prod(shapes[name])
    if match is None or name == wanted:
        return name, range(size)
    first, last = (int(text) if text else None for text in (match["first"], match["last"]))
    if match["colon"]:
        chosen = range(size)[first:last]
    else:
        chosen = range(first, first + 1) if first is not None and 0 <= first < size else range(0)
    if not chosen:
        raise InputError(f"{place} names {wanted!r}, but expects entries 0 to {size - 1} of {name!r}")
    return name, chosen


def needed(place: str, wanted: Iterable[object], shapes: Mapping[str, tuple[int, ...]]) -> dict[str, tuple[int, ...]]:
    """The requested names, whole or by entries, in their order. Raises the errors of `entry`."""
    names = {entry(place, one, shapes)[0] for one in wanted}
    return {name: shape for name, shape in shapes.items() if name in names}


def positions(place: str, wanted: Iterable[str], shapes: Mapping[str, tuple[int, ...]]) -> list[int]:
    """The positions of the requested entries in the vector of all entries. Raises InputError, also for duplicates."""
    if isinstance(wanted, str):
        wanted = [wanted]
    starts, end = {}, 0
    for name, shape in shapes.items():
        starts[name], end = end, end + prod(shape)
    places: list[int] = []
    for one in wanted:
        name, chosen = entry(place, one, shapes)
        places += [starts[name] + i for i in chosen]
    if len(set(places)) < len(places):
        raise InputError(f"{place} has a name twice: {listed(wanted)}")
    return places
