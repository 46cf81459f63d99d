"""A mechanism as MJCF.

A body of MJCF must have mass, or something with mass fixed to it. So the joint of a link without mass that carries a
single other link, such as the first link of a universal joint, becomes the first joint of that other body. With D the
pose of the body in the frame after the joint, at zero, the joint is at the origin of $D^-1$ and has the axis $R_D^T a$.

Source: the pages of https://mujoco.readthedocs.io, XML reference.
"""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from ...errors import ModelError
from ...system import free_name
from ...view import Box, Capsule, Cylinder, Ellipsoid, Mesh, Shape, Sphere
from ..bodies import SpatialInertia
from ..joints import Fixed, Free, Prismatic, Revolute, Spherical
from ..kinematic_tree import KinematicTree
from ..loops import Loop, Metric, PointLoop, PoseLoop
from ..models.looks import FilePlane, MissingMesh
from ..models.mjcf_file import DRAWN_MESHES
from ..tree import Link, solids_of
from .written import Losses, child, children_of, document, has_collision, limits, robot_name, text

_WORLD = "world"
_ROUND_OFF = 1e-9
#: The group of geoms that MuJoCo's viewer does not draw by default.
_HIDDEN = "3"
_TYPES = {Revolute: "hinge", Prismatic: "slide", Spherical: "ball", Free: "free"}


class MjcfText:
    """The writer of one mechanism. It implements `Mechanism.to_mjcf`; `text` is the content of the file."""

    def __init__(self, mechanism: KinematicTree, name: str, leave_out: Collection[str]) -> None:
        self._mechanism, self._losses = mechanism, Losses("to_mjcf", "MJCF", leave_out)
        self._children = children_of(mechanism)
        root = ElementTree.Element("mujoco", model=robot_name("to_mjcf", name))
        child(root, "compiler", angle="radian", inertiafromgeom="false")
        child(root, "option", gravity=text(self._losses.value("gravity", mechanism.gravity)))
        self._assets, self._collides = child(root, "asset"), has_collision(mechanism)
        world = child(root, "worldbody")
        self._bodies = {mechanism.base: world}
        self._frames = set(mechanism.frames)
        if mechanism.base != _WORLD and _WORLD in mechanism.frames:
            raise ModelError(
                "to_mjcf: a link is named 'world', which is the name of the base in MJCF.\n  fix: use renamed(...)"
            )
        if mechanism.base_body is not None:  # the world has no mass, so a body without children has that of the base
            name = mechanism.base if mechanism.base != _WORLD else free_name("base", self._frames)
            self._frames.add(name)
            self._add_inertia(child(world, "body", name=name), name, mechanism.base_body, jointed=False)
        elif mechanism.base != _WORLD:
            child(world, "site", name=mechanism.base)
        self._add_shapes(world, mechanism.base, mechanism)
        for link in self._children[mechanism.base]:
            self._add_body(world, link)
        self._add_equalities(child(root, "equality"))
        self._add_actuators(child(root, "actuator"))
        for kept in mechanism.arguments["keep"]:
            self._losses.add("keep", kept)
        self._losses.check()
        self.text = document(root)

    # ---- bodies ------------------------------------------------------------------------------------------------------

    def _add_body(self, parent: ElementTree.Element, link: Link) -> None:
        passed = [link]
        while self._joins_the_next(passed[-1]):
            passed += self._children[passed[-1].name]
        mounts = [self._losses.value(f"the mount of link {part.name!r}", part.mount) for part in passed]
        body = passed[-1]
        # The pose of the body in the frame after each joint, at zero position.
        after = [np.eye(4)]
        for T in reversed(mounts[1:]):
            after.append(T @ after[-1])
        at = mounts[0] @ after[-1]
        if isinstance(link.joint, Free) and not (np.array_equal(at, np.eye(4)) and parent.tag == "worldbody"):
            raise ModelError(
                f"to_mjcf: the free joint {link.joint.name!r} is mounted at a pose, but in MJCF a free "
                "joint is on the base without a mount.\n"
                "  fix: give its link the identity as mount"
            )
        element = child(parent, "body", name=body.name, **_placed(at))
        self._bodies[body.name] = element
        for part, D in zip(passed, reversed(after), strict=True):
            self._add_joint(element, part, D, body)
        if body.body is not None:
            self._add_inertia(element, body.name, body.body, jointed=bool(body.joint.dofs))
        elif body.joint.dofs and not self._has_mass(body):
            raise ModelError(
                f"to_mjcf: link {body.name!r} moves, but neither it nor a link that is fixed to it has "
                f"mass, which MuJoCo requires.\n  fix: with_inertia({{{body.name!r}: SpatialInertia(...)}})"
            )
        self._add_shapes(element, body.name, body)
        for carried in self._children[body.name]:
            self._add_body(element, carried)

    def _joins_the_next(self, link: Link) -> bool:
        """Whether the joint of a link without mass becomes a joint of the body that the link carries."""
        carried = self._children[link.name]
        alone = link.body is None and len(carried) == 1 and not link.shapes and not link.collision
        return bool(alone and link.joint.dofs and carried[0].joint.dofs)

    def _has_mass(self, link: Link) -> bool:
        fixed = (part for part in self._children[link.name] if not part.joint.dofs)
        return link.body is not None or any(self._has_mass(part) for part in fixed)

    def _add_inertia(self, element: ElementTree.Element, name: str, body: SpatialInertia, jointed: bool) -> None:
        # Of a body that is fixed to its parent, MuJoCo also accepts a mass or an inertia of zero.
        value, of = self._losses.value, f"link {name!r}"
        mass, center = value(f"the mass of {of}", body.mass), value(f"the centre of mass of {of}", body.center_of_mass)
        moments, axes = np.linalg.eigh(value(f"the inertia of {of}", body.inertia))
        small = min(moments[0], mass)
        too_small = small <= 0.0 if jointed else small < 0.0
        if too_small or moments[2] > (moments[0] + moments[1]) * (1.0 + _ROUND_OFF):
            if body is self._mechanism.base_body:  # dynamics do not depend on it, so it may be omitted
                self._losses.add("base_body", name)
                return
            raise ModelError(
                "to_mjcf: MuJoCo requires a positive mass, positive principal moments, and no principal "
                f"moment above the sum of the other two, got {float(mass)} kg and {moments.tolist()} kg m2 of {of}.\n"
                f"  fix: with_inertia({{{name!r}: SpatialInertia(...)}})"
            )
        moments[2] = min(moments[2], moments[0] + moments[1])  # of a flat body, up to round-off
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = axes * np.sign(np.linalg.det(axes)), center
        child(element, "inertial", mass=text(mass), diaginertia=text(moments), **_placed(T))

    def _add_shapes(self, element: ElementTree.Element, name: str, part: Link | KinematicTree) -> None:
        """Add a geom for each shape and each solid of a link or of the base; one for both if they are one object."""
        solids = {id(solid): solid for solid in solids_of(part)} if self._collides else {}
        shapes = {id(shape): shape for shape in part.shapes}
        for key, shape in (shapes | solids).items():
            geom = self._geom(shape)
            if geom is None or (geom["type"] == "plane" and part is not self._mechanism):
                for kind, some in (("shapes", shapes), ("collision", solids)):
                    if key in some:
                        self._losses.add(kind, name)
                continue
            if key not in shapes:
                geom["group"] = _HIDDEN
            rgba = text([*(value / 255.0 for value in shape.color), shape.opacity])
            collides = dict.fromkeys(("contype", "conaffinity"), str(int(key in solids)))
            child(element, "geom", **geom, rgba=rgba, mass="0", **collides, **_placed(shape.at))

    def _geom(self, shape: Shape) -> dict[str, str] | None:
        """The type and size of a geom; None if MJCF has none for the shape."""
        if isinstance(shape, Box):
            return {"type": "box", "size": text(0.5 * np.asarray(shape.lengths))}
        if isinstance(shape, Sphere):
            return {"type": "sphere", "size": text(shape.radius)}
        if isinstance(shape, Ellipsoid):
            return {"type": "ellipsoid", "size": text(shape.radii)}
        if isinstance(shape, (Cylinder, Capsule)):
            kind = "cylinder" if isinstance(shape, Cylinder) else "capsule"
            return {"type": kind, "size": text([shape.radius, 0.5 * shape.length])}
        if isinstance(shape, FilePlane):
            return {"type": "plane", "size": "0 0 1"}  # infinite
        if isinstance(shape, Mesh) and not isinstance(shape, MissingMesh) and isinstance(shape.source, (str, Path)):
            file = Path(shape.source)
            if file.suffix.lower() in DRAWN_MESHES:
                scale = np.broadcast_to(np.asarray(shape.scale, dtype=np.float64), (3,))
                name = f"mesh{len(self._assets)}"
                child(self._assets, "mesh", name=name, file=str(file.absolute()), scale=text(scale))
                return {"type": "mesh", "mesh": name}
        return None

    # ---- joints ------------------------------------------------------------------------------------------------------

    def _add_joint(self, element: ElementTree.Element, link: Link, D: NDArray[np.float64], body: Link) -> None:
        joint, drive, losses = link.joint, link.drive, self._losses
        if isinstance(joint, Fixed):
            return
        if type(joint) not in _TYPES:
            raise ModelError(f"to_mjcf: MJCF has no joint such as {joint!r}, of {type(joint).__name__}")
        turned = not np.array_equal(D[:3, :3], np.eye(3))
        if turned:  # a reader of the file assigns the axes of the body to the frame between two joints
            losses.add("frames", link.name)
        attributes: dict[str, str] = {}
        if isinstance(joint, (Revolute, Prismatic)):
            axis = losses.value(f"the axis of joint {joint.name!r}", joint.axis)
            attributes["axis"] = text(D[:3, :3].T @ axis)
        elif turned:
            raise ModelError(
                f"to_mjcf: link {link.name!r} has no mass, and its ball joint is rotated relative to the next joint"
            )
        if link is not body:
            attributes["pos"] = text(-D[:3, :3].T @ D[:3, 3])
        losses.unlike(link, ("friction_speed", "speed"))
        for name, value in losses.amounts(link, ("armature", "damping", "friction", "stiffness")).items():
            attributes["frictionloss" if name == "friction" else name] = text(value)
        if drive.sprung and isinstance(joint, (Revolute, Prismatic)):
            attributes["springref"] = text(losses.value(f"the rest of joint {joint.name!r}", drive.rest))
        elif drive.sprung:
            losses.unlike(link, ("rest",))
        if drive.lower is not None or drive.upper is not None:
            low, high = limits(drive)
            if joint.dofs == 1 and low < high:
                attributes |= {"limited": "true", "range": text([low, high])}
            else:
                losses.add("limits", joint.name)
        child(element, "joint", name=joint.name, type=_TYPES[type(joint)], **attributes)

    # ---- equalities and motors ---------------------------------------------------------------------------------------

    def _add_equalities(self, equality: ElementTree.Element) -> None:
        for link in self._mechanism.links:
            if link.mimic is not None:
                if not link.mimic.ratio:
                    raise ModelError(f"to_mjcf: the mimic joint {link.joint.name!r} has the ratio 0.\n  fix: lock it")
                polynomial = text([link.mimic.offset, link.mimic.ratio, 0.0, 0.0, 0.0])
                child(equality, "joint", joint1=link.joint.name, joint2=link.mimic.joint, polycoef=polynomial)
        kinds = {PointLoop: "connect", PoseLoop: "weld"}
        if self._mechanism.loops and self._mechanism.loop_metric != Metric():
            self._losses.add("loop_metric", "the mechanism")
        for loop in self._mechanism.loops:
            if type(loop) not in kinds:
                self._losses.add("closures", loop.name)
                continue
            ends = {f"site{i}": self._site(loop, end) for i, end in enumerate((loop.frame, loop.other), start=1)}
            child(equality, kinds[type(loop)], name=loop.name, **ends)

    def _site(self, loop: Loop, frame: str) -> str:
        """A new site at a frame, and its name."""
        name = frame if frame == self._mechanism.base else self._mechanism.link(frame).name
        if name not in self._bodies:
            raise ModelError(
                f"to_mjcf: {loop!r} refers to the frame {name!r}, whose link has no mass and therefore is "
                "not a body in MJCF"
            )
        site = free_name(f"{loop.name} at {name}", self._frames)
        self._frames.add(site)
        child(self._bodies[name], "site", name=site)
        return site

    def _add_actuators(self, actuator: ElementTree.Element) -> None:
        driven = set(self._mechanism.driven)
        for link in self._mechanism.links:
            joint, drive = link.joint, link.drive
            least, most = drive.efforts
            if joint.name not in driven:
                if joint.dofs and (most is not None or drive.gear != 1.0):
                    self._losses.add("effort" if most is not None else "gear", joint.name)
                continue
            attributes: dict[str, str] = {}
            if joint.dofs > 1:
                self._losses.unlike(link, ("gear", "effort"))
            else:
                gear = float(self._losses.value(f"the gear of joint {joint.name!r}", drive.gear))
                attributes["gear"] = text(gear)
                if least is not None and most is not None:
                    if np.isfinite([least, most]).all() and least < most:
                        attributes |= {"ctrllimited": "true", "ctrlrange": text([least, most])}
                    else:
                        self._losses.add("effort", joint.name)
            child(actuator, "motor", joint=joint.name, **attributes)


def _placed(T: Any) -> dict[str, str]:
    """Position and quaternion [w, x, y, z] of a pose."""
    from scipy.spatial.transform import Rotation  # imported here because the package is large

    at = np.asarray(T, dtype=np.float64)
    x, y, z, w = Rotation.from_matrix(at[:3, :3]).as_quat()
    return {"pos": text(at[:3, 3]), "quat": text([w, x, y, z])}
