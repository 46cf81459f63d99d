"""The tree of a robot in URDF: which link each joint carries, and which joint it mimics."""

from __future__ import annotations

from ...checks import listed
from ..tree import Mimic
from .xml_file import Element

#: The types of joints with one degree of freedom.
SINGLE = ("revolute", "continuous", "prismatic")


class UrdfTree:
    """The links and joints of a robot.

    Args:
        robot: the root element, in which names of links are unique, and also names of joints.
    Attributes:
        links, joints: their elements by name.
        root: the name of the link that no joint carries.
        followers: by joint the independent joint that it mimics.
        notes: notes on joints that mimic mimic joints.
    Raises: ModelError with the line of the joint or link, if the links do not form a tree.
    """

    def __init__(self, robot: Element) -> None:
        self.links = {element.text("name"): element for element in robot.all("link")}
        self.joints = {element.text("name"): element for element in robot.all("joint")}
        self.notes = list[str]()
        if not self.links:
            raise robot.wrong("there is no <link>, so this is not a model of a robot")
        carriers = dict[str, Element]()
        for joint in self.joints.values():
            for end in ("parent", "child"):
                if self.end(joint, end) not in self.links:
                    name = self.end(joint, end)
                    raise joint.wrong(
                        f"there is no link {name!r}, the {end} of this joint; links are {listed(self.links, name)}"
                    )
            before = carriers.setdefault(self.end(joint, "child"), joint)
            if before is not joint:
                raise joint.wrong(
                    f"link {self.end(joint, 'child')!r} has two joints that carry it, the other in line {before.line}\n"
                    "  fix: URDF has trees only; close the loop by loops= of Mechanism.replace"
                )
        self.root = self._root_of(carriers)
        self.followers = {name: self._mimic(joint) for name, joint in self.joints.items() if self._follows(joint)}

    @staticmethod
    def end(joint: Element, which: str) -> str:
        """The name of the link at the end `which`, "parent" or "child". Raises ModelError if it does not exist."""
        end = joint.first(which)
        if end is None:
            raise joint.wrong(f"expected <{which} link=...>")
        return end.text("link")

    def _root_of(self, carriers: dict[str, Element]) -> str:
        for name in self.links:
            passed = [name]
            while passed[-1] in carriers:
                joint = carriers[passed[-1]]
                above = self.end(joint, "parent")
                if above in passed:
                    circle = passed[passed.index(above) :]
                    raise joint.wrong(f"the links form a cycle: {listed(circle)}")
                passed.append(above)
        roots = [name for name in self.links if name not in carriers]
        if len(roots) > 1:
            raise self.links[roots[1]].wrong(
                f"no joint carries this link, and none carries {roots[0]!r}; expected one root.\n"
                "  fix: join the two by a joint, of the type fixed or floating"
            )
        return roots[0]

    @staticmethod
    def _follows(joint: Element) -> bool:
        return joint.first("mimic") is not None and joint.text("type") != "fixed"

    def _mimic(self, joint: Element) -> Mimic:
        """The joint that a joint mimics, through a chain of mimic joints. Raises ModelError for an invalid chain."""
        chain, ratio, offset = [joint.text("name")], 1.0, 0.0
        leader = joint
        while self._follows(leader):
            mimic = leader.first("mimic")
            assert mimic is not None
            ratio, offset = ratio * mimic.number("multiplier", 1.0), offset + ratio * mimic.number("offset", 0.0)
            name = mimic.text("joint")
            if name not in self.joints:
                raise joint.wrong(f"it mimics {name!r}, but there is no joint of that name: {self._singles(name)}")
            leader = self.joints[name]
            if leader.text("type") not in SINGLE:
                raise joint.wrong(
                    f"it mimics {name!r}, whose type {leader.text('type')} does not have one degree of "
                    f"freedom: {self._singles()}"
                )
            if name in chain:
                raise joint.wrong(f"the mimic joints {listed(chain)} form a cycle")
            chain.append(name)
        if joint.text("type") not in SINGLE:
            raise joint.wrong("a mimic joint must have the type revolute, continuous or prismatic")
        if len(chain) > 2:
            line = " -> ".join(map(repr, chain))
            self.notes.append(f"joints that follow in a chain: {line}; here {chain[0]!r} follows {chain[-1]!r}")
        return Mimic(chain[-1], ratio, offset)

    def _singles(self, near: str | None = None) -> str:
        names = [name for name, joint in self.joints.items() if joint.text("type") in SINGLE]
        return f"joints of one freedom are {listed(names, near)}"
