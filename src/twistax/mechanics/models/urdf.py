"""Mechanisms from URDF.

Source: the pages of http://wiki.ros.org/urdf/XML. Roll, pitch and yaw are rotations about the parent's fixed x, y and z
axes: R = Rot_z(yaw) Rot_y(pitch) Rot_x(roll).
"""

from __future__ import annotations

import collections
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...checks import listed
from ...errors import TwistaxError
from ...expr.lie.base import unit_vector
from ...system import free_name
from ..arguments import matrix
from ..bodies import SpatialInertia
from ..drives import Drive
from ..joints import Fixed, Free, Joint, Planar, Prismatic, Revolute, Spherical
from ..tree import Link
from ..writers.written import UNLIMITED
from .choices import Choices
from .looks import UrdfLooks
from .urdf_tree import UrdfTree
from .urdf_vocabulary import notes_on
from .xml_file import Element


class Urdf:
    """The links of a URDF robot, and notes on the rest of the file.

    Args:
        robot: the root element.
        choices: which numbers become Parameters.
        floating: whether the root is on a `Free` joint, "root".
        quarter_turns: an angle that differs from a multiple of a quarter turn by at most this, in rad, is rounded.
    Attributes:
        links, base, gravity, driven, notes, shapes, collision, loops, base_body: for `Mechanism`.
    Raises: ModelError with file and line.
    """

    def __init__(self, robot: Element, choices: Choices, *, floating: bool, quarter_turns: float, folder: Path) -> None:
        self.choices, self.quarter_turns = choices, quarter_turns
        self.gravity, self.driven, self.loops = (0.0, 0.0, -9.81), None, ()
        self.notes = notes_on(robot)
        self._tree = tree = UrdfTree(robot)
        self.notes += tree.notes
        self._remarks = collections.defaultdict[str, list[str]](list)
        self._names = {*tree.links, *tree.joints}
        choices.length = self._length(robot)
        self._looks = UrdfLooks(robot, self._placed, robot.path.resolve().parent, folder)
        root = tree.links[tree.root]
        alone = not tree.joints  # in this case the mechanism consists of the root link
        self.base = free_name("world", tree.links) if floating or alone else tree.root
        self.shapes = () if floating or alone else self._looks.of(root)
        self.collision = None if floating or alone else self._looks.collision_of(root)
        self.links = list[Link]()
        if floating or alone:
            self.links.append(self._root(root, Free if floating else Fixed))
        self.base_body = None if floating or alone else self._body(root)
        for joint in tree.joints.values():
            self.links += self._links(joint, None if floating else tree.root)
        if not any(link.joint.dofs for link in self.links):
            self.notes.append("no joint moves; floating=True frees the root link")
        self.notes += [f"{what} {listed(joints)}" for what, joints in self._remarks.items()] + self._looks.notes

    def _root(self, root: Element, kind: type[Free | Fixed]) -> Link:
        name = free_name("root", self._tree.joints)
        if name != "root":
            self.notes.append(f"the free joint of the root link is {name!r}: a joint of the file is named 'root'")
        return Link(kind(name), self._body(root), np.eye(4), name=self._tree.root, **self._looks.both(root))

    def _length(self, robot: Element) -> float:
        """The largest distance of a joint or a centre of mass from its reference frame, m; 1 if there is none."""
        inertials = [inertial for link in robot.all("link") for inertial in link.all("inertial")]
        origins = [element.first("origin") for element in (*robot.all("joint"), *inertials)]
        return max((float(np.linalg.norm(self._placed(origin)[1])) for origin in origins), default=0.0) or 1.0

    def _links(self, element: Element, root: str | None) -> list[Link]:
        """The link that a joint carries; for a planar joint, preceded by a massless link."""
        parent, child = self._tree.end(element, "parent"), self._tree.links[self._tree.end(element, "child")]
        try:
            joint, turned = self._joint(element)
            link = Link(
                joint,
                self._body(child),
                self.choices.origin(element.text("name"), *self._placed(element.first("origin"))),
                parent=None if parent == root else parent,
                name=child.text("name"),
                drive=self._drive(element),
                mimic=self._tree.followers.get(joint.name),
                **self._looks.both(child),
            )
        except TwistaxError as error:
            raise error if str(error).startswith(element.path.name) else element.wrong(str(error)) from None
        if turned is None:
            return [link]
        # The z axis of the joint is not that of the link.
        C = matrix(turned, np.zeros(3))
        plane = free_name(f"{link.name} in its plane", self._names)
        self._names.add(plane)
        return [
            Link(joint, None, link.mount @ C, parent=link.parent, name=plane, drive=link.drive),
            Link(Fixed(plane), link.body, C.T, parent=plane, name=link.name, **self._looks.both(child)),
        ]

    def _joint(self, element: Element) -> tuple[Joint, NDArray[np.float64] | None]:
        name, kind = element.text("name"), element.text("type")
        axis_of = element.first("axis")
        axis = np.array([1.0, 0.0, 0.0]) if axis_of is None else axis_of.numbers("xyz", 3)
        if kind in ("revolute", "continuous"):
            return Revolute(name, self.choices.of(name, "axis", axis)), None
        if kind == "prismatic":
            return Prismatic(name, self.choices.of(name, "axis", axis)), None
        if kind == "fixed":
            return Fixed(name), None
        if kind == "floating":
            return Free(name), None
        if kind == "spherical":
            self._remarks["joints of the type spherical, which URDF does not have and Bullet and MuJoCo read:"].append(
                name
            )
            return Spherical(name), None
        if kind == "planar":
            from ..algorithms.inertia_frames import rotation_to

            normal = unit_vector(f"Planar {name!r}", "axis", axis)
            return Planar(name), None if np.array_equal(normal, [0.0, 0.0, 1.0]) else rotation_to(tuple(normal))
        raise element.wrong(
            f"expected the type revolute, continuous, prismatic, fixed, floating or planar, got {kind!r}"
        )

    def _placed(self, origin: Element | None) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        if origin is None:
            return np.eye(3), np.zeros(3)
        roll, pitch, yaw = (self._angle(angle) for angle in origin.numbers("rpy", 3, np.zeros(3)))
        x = np.array([[1.0, 0.0, 0.0], [0.0, roll[0], -roll[1]], [0.0, roll[1], roll[0]]])
        y = np.array([[pitch[0], 0.0, pitch[1]], [0.0, 1.0, 0.0], [-pitch[1], 0.0, pitch[0]]])
        z = np.array([[yaw[0], -yaw[1], 0.0], [yaw[1], yaw[0], 0.0], [0.0, 0.0, 1.0]])
        return z @ y @ x + 0.0, origin.numbers("xyz", 3, np.zeros(3))

    def _angle(self, angle: float) -> tuple[float, float]:
        turns = round(angle / (0.5 * math.pi))
        if abs(angle - turns * 0.5 * math.pi) <= self.quarter_turns:
            return ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[turns % 4]
        return math.cos(angle), math.sin(angle)

    def _body(self, link: Element) -> SpatialInertia | None:
        inertial = link.first("inertial")
        if inertial is None:
            return None
        mass_of, inertia_of = inertial.first("mass"), inertial.first("inertia")
        mass = 0.0 if mass_of is None else mass_of.number("value")
        entries = np.zeros(6)
        if inertia_of is not None:
            entries = np.array([inertia_of.number(name, 0.0) for name in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")])
        if mass == 0.0 and not entries.any():
            return None
        R, center = self._placed(inertial.first("origin"))
        xx, xy, xz, yy, yz, zz = entries
        tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        return self.choices.body(link.text("name"), mass, center, R, tensor, inertial)

    def _drive(self, element: Element) -> Drive:
        name, dynamics, limit = element.text("name"), element.first("dynamics"), element.first("limit")
        numbers: dict[str, Any] = {}
        if dynamics is not None:
            for what in ("damping", "friction"):
                value = dynamics.number(what, 0.0)
                if value:
                    numbers[what] = self.choices.of(name, what, value)
        return Drive(**numbers, **({} if limit is None else self._limits_of(element, limit)))

    def _limits_of(self, element: Element, limit: Element) -> dict[str, float]:
        """The limits of a joint. Values that represent "no limit" are noted."""
        name, kind = element.text("name"), element.text("type")
        numbers = dict[str, float]()
        for what, attribute in (("speed", "velocity"), ("effort", "effort")):
            if attribute in limit.attributes:
                numbers[what] = limit.number(attribute)
                if numbers[what] == 0.0 and kind != "fixed":
                    self._remarks[
                        f"{attribute} 0, which many programs write where it is not known, taken as the limit of joints"
                    ].append(name)
        if kind not in ("revolute", "prismatic"):
            if kind == "continuous" and limit.attributes.keys() & {"lower", "upper"}:
                self._remarks["lower and upper of the continuous joints"].append(name)
            return numbers
        lower, upper = limit.number("lower", 0.0), limit.number("upper", 0.0)
        if lower > upper:
            self._remarks["lower above upper, which by convention stands for no limits, of joints"].append(name)
            return numbers
        # The largest number represents no limit, see `to_urdf`.
        bounds = {"lower": lower, "upper": upper}
        return numbers | {what: bound for what, bound in bounds.items() if abs(bound) < UNLIMITED}
