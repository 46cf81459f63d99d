"""Edits of the links of a mechanism: locked joints, attached mechanisms, removed links, new names and bodies.

Each function returns the changed arguments of `Mechanism`. Loop constraints, motors and mimic joints are kept; if one
of them cannot be kept, an error names it.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any

import numpy as np

from ...checks import listed, reals, short
from ...errors import ModelError
from ...expr import Concat, Constant, Expr, canonicalize_all
from ...expr.fields import ExprLike
from ...expr.lie.base import check_element
from ...system import free_name
from ..arguments import of_shape, pose
from ..bodies import SpatialInertia
from ..drives import Drive
from ..joints import Fixed
from ..kinematic_tree import KinematicTree
from ..tree import Link

Changes = dict[str, Any]


def parent_of(mechanism: KinematicTree, link: Link) -> str | None:
    """The name of the parent link; None for the base."""
    return None if link.parent == mechanism.base else link.parent


def carrier_of(mechanism: KinematicTree, frame: str) -> str:
    """The name of the link that has a frame, or of the base. A frame may be named by its joint."""
    return frame if frame == mechanism.base else mechanism.link(frame).name


# ---- locked joints
# -----------------------------------------------------------------------------------------------------


def locked(mechanism: KinematicTree, positions: Mapping[str, ExprLike]) -> Changes:
    """Implements `Mechanism.lock`."""
    owner = "Mechanism.lock"
    if not isinstance(positions, Mapping):
        raise ModelError(
            f"{owner} expects positions by the names of joints, got {short(positions)}.\n"
            '  fix: robot.lock({"elbow": 0.5}), in rad or m'
        )
    values = {name: _position(mechanism, owner, name, value) for name, value in positions.items()}
    notes = [note for name, value in values.items() if (note := _beyond_limits(mechanism, name, value))]
    for link in mechanism.links:
        if link.mimic is not None and link.mimic.joint in values:
            values[link.joint.name] = link.mimic.ratio * values[link.mimic.joint] + link.mimic.offset
    links = [_fixed_at(link, values.get(link.joint.name)) for link in mechanism.links]
    return {"links": links, **_without_joints(mechanism, values), "notes": (*mechanism.arguments["notes"], *notes)}


def _position(mechanism: KinematicTree, owner: str, name: str, value: ExprLike) -> Expr:
    """The position of a joint, (k,) or an element of its group. Raises ModelError or ShapeError for an invalid
    position.
    """
    segment = mechanism.segment_of(name)
    joint, mimic = segment.link.joint, segment.link.mimic
    if not joint.dofs:
        raise ModelError(f"{owner}: joint {name!r} does not move")
    if mimic is not None:
        raise ModelError(f"{owner}: joint {name!r} mimics {mimic.joint!r}.\n  fix: lock {mimic.joint!r}")
    what, shape = f"the position of {name!r}", (joint.dofs,) if joint.group is None else joint.group.shape
    if not isinstance(value, Expr):
        value = reals(f"{owner}: {what}", value, ModelError).astype(np.float64)
        if not np.isfinite(value).all():
            raise ModelError(f"{owner} expects {what} to be finite, got {value.tolist()}")
    if value.shape == () and shape == (1,):
        value = Concat(value)
    (position,) = canonicalize_all([of_shape(owner, what, value, shape)])
    if joint.group is not None:
        check_element(owner, what, position)
    return position


def _beyond_limits(mechanism: KinematicTree, name: str, position: Expr) -> str | None:
    drive = mechanism.segment_of(name).link.drive
    low, high = (-np.inf if drive.lower is None else drive.lower), (np.inf if drive.upper is None else drive.upper)
    if not isinstance(position, Constant) or position.value.ndim > 1:
        return None
    inside = bool(np.all((low <= position.value) & (position.value <= high)))
    return None if inside else f"joint {name!r} is locked at {position.value.tolist()}, outside of its limits"


def _fixed_at(link: Link, position: Expr | None) -> Link:
    if position is None:
        return link
    (mount,) = canonicalize_all([link.transform(position)])
    return dataclasses.replace(link, joint=Fixed(link.joint.name), mount=mount, drive=Drive(), mimic=None)


def _without_joints(mechanism: KinematicTree, names: Collection[str]) -> Changes:
    """The remaining motors."""
    driven = mechanism.arguments["driven"]
    return {"driven": driven if driven is None else tuple(name for name in driven if name not in names)}


# ---- removed links and attached mechanisms
# -----------------------------------------------------------------------------


def without(mechanism: KinematicTree, names: Iterable[str]) -> Changes:
    """Implements `Mechanism.without`."""
    owner, names = "Mechanism.without", list(names)
    for name in names:
        if not isinstance(name, str):
            fix = f"\n  fix: without(*{name!r})" if isinstance(name, Collection) else ""
            raise ModelError(f"{owner} expects names of links, got {short(name)}{fix}")
    removed = {mechanism.link(name).name for name in names}
    for link in mechanism.links:  # each follows its parent
        if link.parent in removed:
            removed.add(link.name)
    left = [link for link in mechanism.links if link.name not in removed]
    joints = {link.joint.name for link in mechanism.links if link.name in removed}
    if not left:
        raise ModelError(f"{owner}: the mechanism would have no links")
    for link in left:
        if link.mimic is not None and link.mimic.joint in joints:
            raise ModelError(
                f"{owner}: joint {link.joint.name!r} mimics {link.mimic.joint!r}, which would be removed.\n"
                f"  fix: remove {link.name!r} as well, or lock {link.mimic.joint!r} first"
            )
    loops = []
    for loop in mechanism.loops:
        ends = [carrier_of(mechanism, end) in removed for end in (loop.frame, loop.other)]
        if any(ends) and not all(ends):
            raise ModelError(
                f"{owner}: the loop constraint {loop!r} needs a frame that would be removed.\n"
                "  fix: first replace(loops=[...]) with the remaining loop constraints"
            )
        if not any(ends):
            loops.append(loop)
    return {"links": left, **_without_joints(mechanism, joints), "loops": loops}


def attached(mechanism: KinematicTree, other: KinematicTree, frame: str | None, at: ExprLike | None) -> Changes:
    """Implements `Mechanism.attach`."""
    owner = "Mechanism.attach"
    if not isinstance(other, KinematicTree):
        raise ModelError(
            f"{owner} expects another Mechanism, got {short(other)}.\n"
            "  fix: to add a body to a link, with_inertia({link: robot.link(link).body + body})"
        )
    T = pose(owner, "pose", np.eye(4) if at is None else at)
    carrier = mechanism.base if frame is None else carrier_of(mechanism, frame)
    _need_other_names(owner, mechanism, other)
    joints = {link.joint.name for tree in (mechanism, other) for link in tree.links}
    mount = Fixed(free_name(f"{other.base} fixed", joints))
    parent = None if carrier == mechanism.base else carrier
    solids: dict[str, Any] = {"shapes": other.shapes, "collision": other.collision}
    base = Link(mount, other.base_body, T, parent=parent, name=other.base, **solids)
    links = [dataclasses.replace(link, parent=parent_of(other, link) or other.base) for link in other.links]
    if mechanism.loops and other.loops and mechanism.loop_metric != other.loop_metric:
        raise ModelError(
            f"{owner}: the two mechanisms have different loop metrics, {mechanism.loop_metric} and "
            f"{other.loop_metric}.\n"
            "  fix: first replace(loop_metric=...) of one of them"
        )
    ours, theirs = mechanism.arguments, other.arguments
    explicit = ours["driven"] is not None or theirs["driven"] is not None
    return {
        "links": [*mechanism.links, base, *links],
        "keep": (*_names(ours["keep"]), *_names(theirs["keep"])),
        "notes": (*ours["notes"], *theirs["notes"]),
        "driven": (*mechanism.driven, *other.driven) if explicit else None,
        "loops": (*mechanism.loops, *other.loops),
        "loop_metric": mechanism.loop_metric if mechanism.loops or not other.loops else other.loop_metric,
    }


def _need_other_names(owner: str, mechanism: KinematicTree, other: KinematicTree) -> None:
    """Raise ModelError for names that both mechanisms have."""
    kinds: dict[str, Callable[[KinematicTree], set[str]]] = {
        "frames": lambda tree: set(tree.frames),
        "joints": lambda tree: {link.joint.name for link in tree.links},
        "closures": lambda tree: {loop.name for loop in tree.loops},
    }
    for kind, names in kinds.items():
        both = names(mechanism) & names(other)
        if both:
            raise ModelError(
                f"{owner}: both mechanisms have {kind} named {listed(sorted(both))}.\n"
                "  fix: attach(other.renamed('left_'), ...)"
            )


def _names(names: Collection[str]) -> tuple[str, ...]:
    return (names,) if isinstance(names, str) else tuple(names)


# ---- names and bodies ------------------------------------------------------------------------------------------------


def renamed(mechanism: KinematicTree, prefix: str) -> Changes:
    """Implements `Mechanism.renamed`."""
    if not isinstance(prefix, str) or not prefix:
        raise ModelError(f"Mechanism.renamed expects a prefix, such as 'left_', got {prefix!r}")

    def link_of(link: Link) -> Link:
        parent, mimic = parent_of(mechanism, link), link.mimic
        return dataclasses.replace(
            link,
            joint=link.joint.renamed(prefix + link.joint.name),
            parent=None if parent is None else prefix + parent,
            name=prefix + link.name,
            mimic=None if mimic is None else dataclasses.replace(mimic, joint=prefix + mimic.joint),
        )

    loops = []
    for loop in mechanism.loops:
        loop = copy.copy(loop)
        loop.name, loop.frame, loop.other = prefix + loop.name, prefix + loop.frame, prefix + loop.other
        loops.append(loop)
    driven = mechanism.arguments["driven"]
    return {
        "links": [link_of(link) for link in mechanism.links],
        "base": prefix + mechanism.base,
        "keep": tuple(prefix + name for name in _names(mechanism.arguments["keep"])),
        "driven": None if driven is None else tuple(prefix + name for name in driven),
        "loops": loops,
    }


def with_inertia(mechanism: KinematicTree, bodies: Mapping[str, SpatialInertia | None]) -> Changes:
    """Implements `Mechanism.with_inertia`."""
    if not isinstance(bodies, Mapping):
        raise ModelError(f"Mechanism.with_inertia expects bodies by the names of links, got {short(bodies)}")
    by_link = {carrier_of(mechanism, name): body for name, body in bodies.items()}
    return {
        "links": [
            dataclasses.replace(link, body=by_link[link.name]) if link.name in by_link else link
            for link in mechanism.links
        ],
        "base_body": by_link.get(mechanism.base, mechanism.base_body),
    }
