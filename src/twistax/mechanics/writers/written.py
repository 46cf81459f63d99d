"""Functions that both writers use: expressions as numbers, numbers as text, and a list of the features that a format
cannot express.
"""

from __future__ import annotations

import collections
import sys
from collections.abc import Collection, Iterable
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from ...checks import instance, listed, name_list, short
from ...errors import ModelError
from ...expr import Constant, to_expr
from ...expr.fields import ExprLike
from ...expr.graph import leaves_of
from ..arguments import known_value
from ..drives import Drive
from ..kinematic_tree import KinematicTree
from ..tree import Link

#: Replaces a missing limit in formats that have none or both. Readers treat it as no limit.
UNLIMITED = sys.float_info.max
#: Kinds of features that may be omitted.
_KINDS = (
    "armature", "base_body", "closures", "collision", "driven", "effort", "frames", "friction_speed", "gear", "gravity",
    "keep", "limits", "loop_metric", "rest", "shapes", "speed", "stiffness",
)  # fmt: skip


class Losses:
    """The features that a format cannot express, by kind: an error unless the caller omits them.

    Args:
        owner: the name of the method in messages.
        language: the name of the format.
        leave_out: kinds of features that the caller omits.
    Raises: ModelError for an unknown kind.
    """

    def __init__(self, owner: str, language: str, leave_out: Collection[str]) -> None:
        self.owner, self.language = owner, language
        self._allowed = set(name_list(f"{owner}: leave_out", leave_out, ModelError))
        self._places = collections.defaultdict[str, list[str]](list)
        for name in sorted(self._allowed - set(_KINDS)):
            raise ModelError(f"{owner} cannot leave out {name!r}; possible kinds are {listed(_KINDS, name)}")

    def add(self, kind: str, place: str) -> None:
        """Note a feature of a joint, a link or a loop constraint that the format cannot express."""
        if kind not in self._allowed and place not in self._places[kind]:
            self._places[kind].append(place)

    def check(self) -> None:
        """Raise ModelError if a feature would be lost that the caller does not omit."""
        if self._places:
            lines = "".join(f"\n  {kind}: of {listed(places)}" for kind, places in sorted(self._places.items()))
            raise ModelError(
                f"{self.owner}: {self.language} cannot express{lines}\n"
                f"  fix: {self.owner}(leave_out={sorted(self._places)}) to omit them, or change the "
                "mechanism by `replace`"
            )

    def value(self, what: str, value: ExprLike) -> NDArray[np.float64]:
        """The numbers of an expression, with the default values of Parameters. Raises ModelError if there are none."""
        known = known_value(value)
        if known is None:
            leaves = (leaf for leaf in leaves_of(to_expr(value)) if not isinstance(leaf, Constant))
            leaf = next((leaf for leaf in leaves if getattr(leaf, "value", None) is None), None)
            if leaf is not None:
                raise ModelError(f"{self.owner}: {what} is {short(value)}, and {leaf!r} has no value")
            raise ModelError(f"{self.owner}: {what} is not a finite number: {short(value)}")
        return np.asarray(np.add(known, 0.0), dtype=np.float64)  # without negative zeros

    def amounts(self, link: Link, names: Iterable[str]) -> dict[str, float]:
        """The nonzero values of a drive, by name."""
        values = {
            name: float(self.value(f"the {name} of joint {link.joint.name!r}", getattr(link.drive, name)))
            for name in names
        }
        return {name: value for name, value in values.items() if value}

    def unlike(self, link: Link, names: Iterable[str]) -> None:
        """Note the values of a drive that differ from their defaults."""
        usual = Drive()
        for name in names:
            if repr(getattr(link.drive, name)) != repr(getattr(usual, name)):
                self.add(name, link.joint.name)


def robot_name(owner: str, name: str) -> str:
    """The name of the robot. Raises ModelError for a path, because the writers return text and write no file."""
    instance(f"{owner}: name", name, str, "text", ModelError)
    if set(name) & set("/\\") or name.endswith((".urdf", ".xml")):
        raise ModelError(
            f"{owner}: name expects the name of the robot, got the path {name!r}.\n"
            f"  fix: pathlib.Path({name!r}).write_text(mechanism.{owner}())"
        )
    return name


def text(values: ExprLike) -> str:
    """Numbers separated by spaces, with enough digits to be read back exactly."""
    return " ".join(repr(float(x)) for x in np.ravel(np.asarray(values)))


def child(parent: ElementTree.Element, tag: str, **attributes: str) -> ElementTree.Element:
    """A new child element, appended to another element."""
    return ElementTree.SubElement(parent, tag, attributes)


def document(root: ElementTree.Element) -> str:
    """The text of a file."""
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=False) + "\n"


def limits(drive: Drive) -> tuple[float, float]:
    """Both bounds of a position, `UNLIMITED` for a missing one."""
    return (
        -UNLIMITED if drive.lower is None else float(drive.lower),
        UNLIMITED if drive.upper is None else float(drive.upper),
    )


def has_collision(mechanism: KinematicTree) -> bool:
    """Whether a part of a mechanism has collision geometry.

    A reader of a file with some uses nothing else in distances, so for the other parts `solids_of` is written.
    """
    parts: list[Link | KinematicTree] = [mechanism, *mechanism.links]
    return any(part.collision is not None for part in parts)


def children_of(mechanism: KinematicTree) -> dict[str, list[Link]]:
    """The child links of every link, and of the base."""
    children: dict[str, list[Link]] = {name: [] for name in mechanism.frames}
    for link in mechanism.links:
        children[mechanism.base if link.parent is None else link.parent].append(link)
    return children
