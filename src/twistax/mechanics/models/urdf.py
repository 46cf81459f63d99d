"""Mechanisms from URDF.

Source: the pages of http://wiki.ros.org/urdf/XML. Roll, pitch and yaw are turns about the
parent's fixed x, y and z axes: R = Rot_z(yaw) Rot_y(pitch) Rot_x(roll).
"""

from __future__ import annotations

import collections
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import TwistaxError
from ..arguments import matrix
from ..bodies import SpatialInertia
from ..drives import Drive
from ..joints import Fixed, Free, Joint, Planar, Prismatic, Revolute
from ..tree import Link, Mimic
from .choices import Choices
from .looks import UrdfLooks
from .xml_file import Element

_USED = {
    "robot": {"link", "joint", "material"},
    "link": {"inertial", "visual"},
    "joint": {"origin", "parent", "child", "axis", "limit", "dynamics", "mimic"},
}


class Urdf:
    """The links of a robot, and what the file has beside them.

    Args:
        robot: the root element.
        choices: which numbers become Parameters.
        floating: the root is on a `Free` joint, "root".
        quarter_turns: an angle this near to a multiple of a quarter turn, in rad, is taken as that.
    Attributes:
        links, base, gravity, driven, notes, shapes, loops: for `Mechanism`.
    Raises: ModelError with file and line.
    """

    def __init__(self, robot: Element, choices: Choices, *, floating: bool, quarter_turns: float) -> None:
        self.choices, self.quarter_turns = choices, quarter_turns
        self.notes, self.gravity, self.driven, self.loops = list[str](), (0.0, 0.0, -9.81), None, ()
        elements = {element.text("name"): element for element in robot.all("link")}
        joints = robot.all("joint")
        children = set[str]()
        for joint in joints:
            for end in ("parent", "child"):
                if self._end(joint, end) not in elements:
                    raise joint.wrong(f"there is no link {self._end(joint, end)!r}, its {end}")
            if self._end(joint, "child") in children:
                raise joint.wrong(f"link {self._end(joint, 'child')!r} has two joints that carry it")
            children.add(self._end(joint, "child"))
        roots = [name for name in elements if name not in children]
        if len(roots) != 1:
            raise robot.wrong(f"expected one link that no joint carries, got {roots}")
        if not joints and not floating:
            raise robot.wrong(
                "there is no joint, so nothing moves.\n  fix: floating=True, if the link is free in space"
            )
        self._looks = UrdfLooks(robot, self._placed)
        self.base = "world" if floating else roots[0]
        self.shapes = () if floating else self._looks.of(elements[roots[0]])
        self.links = list[Link]()
        if floating:
            root = elements[roots[0]]
            self.links.append(
                Link(Free("root"), self._body(root), np.eye(4), name=roots[0], shapes=self._looks.of(root))
            )
        elif self._body(elements[roots[0]]) is not None:
            self.notes.append(f"the mass of {roots[0]!r}, which does not move")
        for joint in joints:
            self.links += self._links(joint, elements[self._end(joint, "child")], None if floating else roots[0])
        unused = collections.Counter(
            f"<{child.tag}> of <{element.tag}>"
            for element in (robot, *robot.children)
            for child in element.children
            if element.tag in _USED and child.tag not in _USED[element.tag]
        )
        self.notes += [f"{what}, {count} times" for what, count in sorted(unused.items())] + self._looks.notes

    @staticmethod
    def _end(joint: Element, which: str) -> str:
        end = joint.first(which)
        if end is None:
            raise joint.wrong(f"expected <{which} link=...>")
        return end.text("link")

    def _links(self, element: Element, child: Element, root: str | None) -> list[Link]:
        parent = self._end(element, "parent")
        try:
            joint, turned = self._joint(element)
            link = Link(
                joint,
                self._body(child),
                self.choices.origin(element.text("name"), *self._placed(element.first("origin"))),
                parent=None if parent == root else parent,
                name=child.text("name"),
                drive=self._drive(element),
                mimic=self._mimic(element) if joint.dofs else None,
                shapes=self._looks.of(child),
            )
        except TwistaxError as error:
            raise error if element.path.name in str(error) else element.wrong(str(error)) from None
        if turned is None:
            return [link]
        # The joint's own z axis is not that of the link.
        C = matrix(turned, np.zeros(3))
        plane = f"{link.name} in its plane"
        return [
            Link(joint, None, link.mount @ C, parent=link.parent, name=plane, drive=link.drive),
            Link(Fixed(plane), link.body, C.T, parent=plane, name=link.name, shapes=link.shapes),
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
        if kind == "planar":
            from ..inertia_frames import rotation_to

            along = axis / np.linalg.norm(axis)
            return Planar(name), None if np.array_equal(along, [0.0, 0.0, 1.0]) else rotation_to(tuple(along))
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
        """Cosine and sine."""
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
        name, kind = element.text("name"), element.text("type")
        dynamics, limit = element.first("dynamics"), element.first("limit")
        given: dict[str, Any] = {}
        if dynamics is not None:
            for what in ("damping", "friction"):
                value = dynamics.number(what, 0.0)
                if value:
                    given[what] = self.choices.of(name, what, value)
        if limit is not None:
            for what, attribute in (("speed", "velocity"), ("effort", "effort")):
                if attribute in limit.attributes:
                    given[what] = limit.number(attribute)
            if kind in ("revolute", "prismatic"):
                given |= {"lower": limit.number("lower", 0.0), "upper": limit.number("upper", 0.0)}
        return Drive(**given)

    @staticmethod
    def _mimic(element: Element) -> Mimic | None:
        mimic = element.first("mimic")
        if mimic is None:
            return None
        return Mimic(mimic.text("joint"), mimic.number("multiplier", 1.0), mimic.number("offset", 0.0))
