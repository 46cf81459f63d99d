"""A mechanism as URDF.

Source: the pages of http://wiki.ros.org/urdf/XML. R = Rot_z(yaw) Rot_y(pitch) Rot_x(roll).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from ...errors import ModelError
from ...expr.fields import ExprLike
from ...view import Box, Capsule, Cylinder, Mesh, Shape, Sphere
from ..bodies import SpatialInertia
from ..joints import Fixed, Free, Joint, Planar, Prismatic, Revolute, Spherical
from ..kinematic_tree import KinematicTree
from ..tree import Link, solids_of
from .written import Losses, child, document, has_collision, limits, robot_name, text

_GRAVITY = np.array([0.0, 0.0, -9.81])
#: The types of joints without limits of the position.
_TYPES: dict[type[Joint], str] = {
    Fixed: "fixed",
    Revolute: "continuous",
    Prismatic: "prismatic",
    Free: "floating",
    Spherical: "spherical",
    Planar: "planar",
}


def urdf_text(mechanism: KinematicTree, name: str, leave_out: Collection[str]) -> str:
    """Implements `Mechanism.to_urdf`."""
    losses = Losses("to_urdf", "URDF", leave_out)
    robot = ElementTree.Element("robot", name=robot_name("to_urdf", name))
    if not np.array_equal(losses.value("gravity", mechanism.gravity), _GRAVITY):
        losses.add("gravity", "the mechanism")
    for loop in mechanism.loops:
        losses.add("closures", loop.name)
    if set(mechanism.driven) != {s.link.joint.name for s in mechanism.segments if s.moves_by_motor}:
        losses.add("driven", "the mechanism")
    for kept in mechanism.arguments["keep"]:
        losses.add("keep", kept)
    collides = has_collision(mechanism)
    _add_link(robot, losses, mechanism.base, mechanism.base_body, _solids(mechanism, collides))
    for link in mechanism.links:
        _add_link(robot, losses, link.name, link.body, _solids(link, collides))
        _add_joint(robot, losses, link, mechanism.base if link.parent is None else link.parent)
    losses.check()
    return document(robot)


def _solids(part: Link | KinematicTree, collides: bool) -> dict[str, Iterable[Shape]]:
    """The shapes of a link or of the base, by the element that contains them.

    Args:
        collides: whether the file has <collision>.
    """
    return {"visual": part.shapes, "collision": solids_of(part) if collides else ()}


def _add_link(
    robot: ElementTree.Element,
    losses: Losses,
    name: str,
    body: SpatialInertia | None,
    solids: dict[str, Iterable[Shape]],
) -> None:
    element = child(robot, "link", name=name)
    if body is not None:
        of = f"link {name!r}"
        inertial = child(element, "inertial")
        center = losses.value(f"the centre of mass of {of}", body.center_of_mass)
        child(inertial, "origin", xyz=text(center), rpy="0.0 0.0 0.0")
        child(inertial, "mass", value=text(losses.value(f"the mass of {of}", body.mass)))
        tensor = losses.value(f"the inertia of {of}", body.inertia)
        rows, columns = np.triu_indices(3)
        entries = {f"i{'xyz'[i]}{'xyz'[j]}": text(tensor[i, j]) for i, j in zip(rows, columns, strict=True)}
        child(inertial, "inertia", **entries)
    for tag, shapes in solids.items():
        for shape in shapes:
            solid = _solid(shape)
            if solid is None:
                losses.add("shapes" if tag == "visual" else "collision", name)
                continue
            part = child(element, tag)
            _add_origin(part, shape.at)
            child(part, "geometry").append(solid)
            if tag == "visual":
                color = [*(value / 255.0 for value in shape.color), shape.opacity]
                child(child(part, "material", name=""), "color", rgba=text(color))


def _solid(shape: Shape) -> ElementTree.Element | None:
    if isinstance(shape, Box):
        return ElementTree.Element("box", size=text(shape.lengths))
    if isinstance(shape, Sphere):
        return ElementTree.Element("sphere", radius=text(shape.radius))
    if isinstance(shape, (Cylinder, Capsule)):
        tag = "cylinder" if isinstance(shape, Cylinder) else "capsule"
        return ElementTree.Element(tag, radius=text(shape.radius), length=text(shape.length))
    if isinstance(shape, Mesh) and isinstance(shape.source, (str, Path)) and str(shape.source):
        scale = np.broadcast_to(np.asarray(shape.scale, dtype=np.float64), (3,))
        return ElementTree.Element("mesh", filename=str(shape.source), scale=text(scale))
    return None


def _add_joint(robot: ElementTree.Element, losses: Losses, link: Link, parent: str) -> None:
    joint, drive = link.joint, link.drive
    if type(joint) not in _TYPES:
        raise ModelError(f"to_urdf: URDF has no joint such as {joint!r}, of {type(joint).__name__}")
    kind = _TYPES[type(joint)]
    limited = drive.lower is not None or drive.upper is not None
    if limited and kind == "continuous":
        kind = "revolute"
    element = child(robot, "joint", name=joint.name, type=kind)
    _add_origin(element, losses.value(f"the mount of link {link.name!r}", link.mount))
    child(element, "parent", link=parent)
    child(element, "child", link=link.name)
    if isinstance(joint, (Revolute, Prismatic)):
        child(element, "axis", xyz=text(losses.value(f"the axis of joint {joint.name!r}", joint.axis)))
    if isinstance(joint, Planar):
        child(element, "axis", xyz="0.0 0.0 1.0")
    if link.mimic is not None:
        ratio, offset = text(link.mimic.ratio), text(link.mimic.offset)
        child(element, "mimic", joint=link.mimic.joint, multiplier=ratio, offset=offset)
    if joint.dofs:
        _add_drive(element, losses, link, kind, limited)


def _add_drive(element: ElementTree.Element, losses: Losses, link: Link, kind: str, limited: bool) -> None:
    drive = link.drive
    losses.unlike(link, ("armature", "stiffness", "rest", "gear", "friction_speed"))
    attributes: dict[str, str] = {}
    if limited or (kind == "prismatic" and (drive.speed is not None or drive.effort is not None)):
        if kind in ("revolute", "prismatic"):
            low, high = limits(drive)
            attributes |= {"lower": text(low), "upper": text(high)}
        else:
            losses.add("limits", link.joint.name)
    if drive.speed is not None:
        attributes["velocity"] = text(drive.speed)
    least, most = drive.efforts
    if least is not None and most is not None:
        if least == -most and np.isfinite(most):
            attributes["effort"] = text(most)
        else:
            losses.add("effort", link.joint.name)
    if attributes:
        child(element, "limit", **attributes)
    if amounts := losses.amounts(link, ("damping", "friction")):
        child(element, "dynamics", **{name: text(value) for name, value in amounts.items()})


def _add_origin(element: ElementTree.Element, T: ExprLike) -> None:
    at = np.asarray(T, dtype=np.float64)
    child(element, "origin", xyz=text(at[:3, 3]), rpy=text(roll_pitch_yaw(at[:3, :3])))


def roll_pitch_yaw(R: NDArray[np.float64]) -> tuple[float, float, float]:
    """The roll, pitch and yaw of a rotation, accurate to round-off at all angles: the roll is computed from
    Rot_z(yaw)^T R.
    """
    yaw = math.atan2(R[1, 0], R[0, 0])
    s, c = math.sin(yaw), math.cos(yaw)
    pitch = math.atan2(-R[2, 0], c * R[0, 0] + s * R[1, 0])
    roll = math.atan2(s * R[0, 2] - c * R[1, 2], c * R[1, 1] - s * R[0, 1])
    return roll, pitch, yaw
