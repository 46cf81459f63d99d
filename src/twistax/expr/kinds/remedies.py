"""Remedies in messages for kind errors: which operator connects both values."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from .declare import kind_of
from .unit import Unit


def remedy_of_frames(leaves: Iterable[Any], one: str, other: str, first: Any, second: Any) -> str:
    """The operator between two frames, built from a rotation or pose that a leaf declares, if there is one."""
    for leaf in leaves:
        kind = kind_of(leaf)
        frames: dict[int, str] = {} if kind is None else kind.frames()
        to, source = frames.get(-2), frames.get(-1)
        if {to, source} != {one, other} or to == source:
            continue
        # A vector that is a leaf is what the reader wrote; an input is likelier meant in another frame than a state.
        moved, frame = max(((first, one), (second, other)), key=lambda pair: _likely(pair[0]))
        if moved.ndim != 1 or not moved.is_leaf:
            return (
                f"{leaf.name} maps {source!r} to {to!r}, tx.lie.Inverse({leaf.name}) maps back: "
                "one of them is missing, or stands the wrong way round"
            )
        element = leaf.name if frame == source else f"tx.lie.Inverse({leaf.name})"
        target = to if frame == source else source
        return f"{_carried(leaf, element, moved)} is in {target!r}; or declare the frame that is meant"
    return "carry one of them to the other frame by a rotation or pose between both, or declare the frame that is meant"


def _likely(value: Any) -> tuple[bool, bool, bool]:
    """Whether a value is a vector, a leaf, and no state: what is to be carried has most of these."""
    return value.ndim == 1, value.is_leaf, not hasattr(value, "group")


def _carried(leaf: Any, element: str, moved: Any) -> str:
    name = moved.name
    if leaf.shape == (4, 4) and moved.shape == (6,):
        space = getattr(kind_of(moved), "space", None)
        wrench = "" if space is None or space.name == "MOTION" else "Dual"
        return f"tx.lie.SE3Adjoint{wrench}({element}) @ {name}"
    if leaf.shape == (4, 4):
        element = element.replace(leaf.name, f"{leaf.name}[:3, :3]")
    if leaf.shape == (4,):
        element = element.replace(leaf.name, f"tx.spatial.QDCM({leaf.name})")
    back = f"multiply by {leaf.name}.T: " if leaf.shape == (3, 3) and element != leaf.name else ""
    return f"{back}{element} @ {name}"


def remedy_of_spaces() -> str:
    """The operators between twists and their duals."""
    return (
        "an inertia M makes a momentum of a twist, M @ V, and tx.linalg.Solve(M, F) the rate of a twist of a wrench; "
        "tx.lie.SE3Adjoint carries twists and tx.lie.SE3AdjointDual wrenches to another frame; a power is F @ V"
    )


def remedy_of_units(units: Sequence[Unit], wanted: Unit) -> str:
    """The conversion that is needed between two units."""
    between = units[-1] / (units[0] if len(units) > 1 else wanted)
    return (
        f"divide by a factor in {between}, or declare the units that are meant by unit=; "
        "a float, such as 9.81, may have any"
    )
