"""A tree with another root link: the joints between the new and the old root are reversed.

A joint with mount M has its child at M J(q) in its parent, so the parent is at $J(q)^-1 M^-1$ in the child: first the
reversed joint, then the inverse of the old mount.
"""

from __future__ import annotations

import copy
import dataclasses
import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np

from ...checks import listed
from ...errors import ModelError
from ...expr import Constant, Expr, canonicalize_all
from ...expr.lie import Inverse
from ...system import free_name
from ..drives import Drive
from ..joints import Fixed, Free
from ..kinematic_tree import KinematicTree
from ..tree import Link
from .edits import Changes, carrier_of, parent_of

_UNIT = np.eye(4)


def rerooted(mechanism: KinematicTree, frame: str) -> Changes:
    """Implements `Mechanism.rerooted`."""
    if frame == mechanism.base:
        return {}
    path = [mechanism.link(frame)]
    while (parent := parent_of(mechanism, path[-1])) is not None:
        path.append(mechanism.link(parent))
    joints = {link.joint.name for link in mechanism.links}
    top, changes = path[-1], Changes()
    alone = sum(parent_of(mechanism, link) is None for link in mechanism.links) == 1
    if not (isinstance(top.joint, Free) or (isinstance(top.joint, Fixed) and alone)):
        # The base itself is the old root: it becomes a link, and the new base is called "world".
        old = mechanism.base
        solids: dict[str, Any] = {"shapes": mechanism.shapes, "collision": mechanism.collision}
        top = Link(Fixed(free_name("root", joints)), mechanism.base_body, _UNIT, name=old, **solids)
        path.append(top)
        joints.add(top.joint.name)
        changes = {"base": free_name("world", mechanism.frames), "shapes": (), "collision": None, "base_body": None}
        gravity = mechanism.gravity
        if not isinstance(gravity, Constant) or gravity.value.any():
            changes["notes"] = (*mechanism.arguments["notes"], f"gravity is in the axes of {path[0].name!r} now")
    names = {*mechanism.frames, changes.get("base", mechanism.base)}
    root = dataclasses.replace(path[0], joint=top.joint, mount=top.mount, parent=None, drive=top.drive, mimic=None)
    turned = [root]
    for child, parent_link in itertools.pairwise(path):
        turned += _turned(child, parent_link, names, joints)
    on_path = {link.name for link in path}
    rest = [
        dataclasses.replace(link, parent=mechanism.base) if parent_of(mechanism, link) is None and changes else link
        for link in mechanism.links
        if link.name not in on_path
    ]
    loops = []
    for loop in mechanism.loops:  # the name of the joint now names another frame
        loop = copy.copy(loop)
        loop.frame, loop.other = carrier_of(mechanism, loop.frame), carrier_of(mechanism, loop.other)
        loops.append(loop)
    return {"links": [*turned, *rest], "loops": loops, **changes}


def _turned(child: Link, parent: Link, names: set[str], joints: set[str]) -> Iterator[Link]:
    """The links that carry the old parent on the old child."""
    if child.joint.group is not None and (special := _special(child.drive)):
        raise ModelError(
            f"Mechanism.rerooted: joint {child.joint.name!r} would be reversed, and its drive has {listed(special)}, "
            "which are defined in the axes of its child.\n  fix: first replace(drives={...: Drive()})"
        )
    carried: dict[str, Any] = {name: getattr(parent, name) for name in ("body", "name", "shapes", "collision")}
    (mount,) = canonicalize_all([Inverse(child.mount)])
    arguments: dict[str, Any] = {"drive": child.drive, "mimic": child.mimic, "parent": child.name}
    joint = child.joint.reversed()
    if isinstance(joint, Fixed):
        yield Link(joint, mount=mount, parent=child.name, **carried)
    elif _is_unit(mount):
        yield Link(joint, mount=_UNIT, **arguments, **carried)
    else:
        between = free_name(f"{parent.name} at {joint.name}", names)
        names.add(between)
        fixed = Fixed(free_name(f"{parent.name} fixed", joints))
        joints.add(fixed.name)
        yield Link(joint, None, _UNIT, name=between, **arguments)
        yield Link(fixed, mount=mount, parent=between, **carried)


def _is_unit(T: Expr) -> bool:
    return isinstance(T, Constant) and np.array_equal(T.value, _UNIT)


def _special(drive: Drive) -> list[str]:
    """The attributes of a drive that differ from their defaults."""
    usual = Drive()
    names = [field.name for field in dataclasses.fields(drive)]
    return [name for name in names if repr(getattr(drive, name)) != repr(getattr(usual, name))]
