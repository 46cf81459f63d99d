"""The elements and attributes of URDF, and notes on those in a file that are not used.

Source: the pages of http://wiki.ros.org/urdf/XML, and the parser urdfdom for details that they omit.
"""

from __future__ import annotations

import collections
import dataclasses
import difflib
import re

from .xml_file import Element


@dataclasses.dataclass(frozen=True)
class _Kind:
    """The possible content of an element: attributes, children that occur once, and children that occur any number of
    times.

    `unused` are children of URDF that the dynamics do not need; their content is ignored.
    """

    attributes: str = ""
    once: str = ""
    often: str = ""
    unused: str = ""


_SOLID = "box cylinder sphere capsule mesh"
_VOCABULARY = {
    "robot": _Kind("name version", "", "link joint material", "transmission gazebo sensor ros2_control mujoco"),
    "link": _Kind("name type", "inertial", "visual collision"),
    "inertial": _Kind("", "origin mass inertia"),
    "origin": _Kind("xyz rpy"),
    "mass": _Kind("value"),
    "inertia": _Kind("ixx ixy ixz iyy iyz izz"),
    "visual": _Kind("name", "origin geometry material"),
    "collision": _Kind("name", "", "origin geometry material"),
    "geometry": _Kind("name", _SOLID),
    "box": _Kind("size"),
    "cylinder": _Kind("radius length"),
    "capsule": _Kind("radius length"),
    "sphere": _Kind("radius"),
    "mesh": _Kind("filename scale"),
    "material": _Kind("name", "color texture"),
    "color": _Kind("rgba"),
    "texture": _Kind("filename"),
    "joint": _Kind("name type", "origin parent child axis limit dynamics mimic", "", "safety_controller calibration"),
    "parent": _Kind("link"),
    "child": _Kind("link"),
    "axis": _Kind("xyz"),
    "limit": _Kind("lower upper effort velocity"),
    "dynamics": _Kind("damping friction"),
    "mimic": _Kind("joint multiplier offset"),
}
#: An expression of xacro in an attribute, or a xacro command.
_MACRO = re.compile(r"\$\{|\$\([a-z]+ ")


def notes_on(robot: Element) -> list[str]:
    """Notes on the elements and attributes of a robot that are not used, known or unknown.

    Raises: ModelError for macros that are not expanded, for two links or two joints of one name, and for a repeated
        element that URDF allows once.
    """
    _refuse_macros(robot)
    for kind in ("link", "joint"):
        _refuse_repeated(robot.all(kind), kind)
    unused: dict[str, list[int]] = collections.defaultdict(list)
    _look(robot, unused)
    for origin in (o for element in robot.children for o in [element, *element.children] for o in o.all("origin")):
        if "quat_xyzw" in origin.attributes:
            raise origin.wrong("quat_xyzw is not supported.\n  fix: write the rotation as rpy")
    return [f"{what}: {_lines(lines)}" for what, lines in sorted(unused.items())]


def _lines(lines: list[int]) -> str:
    shown = ", ".join(map(str, lines[:3]))
    many = f", ..., {len(lines)} times" if len(lines) > 3 else ""
    return f"line{'s' if len(lines) > 1 else ''} {shown}{many}"


def _refuse_macros(element: Element) -> None:
    """Raise ModelError at the first element or attribute of xacro."""
    what = f"<{element.tag}>" if element.tag.startswith("xacro:") else ""
    for name, value in element.attributes.items():
        if _MACRO.search(value):
            what = what or f"{name}={value!r}"
    if what:
        name = element.path.name
        source = name if name.endswith(".xacro") else f"{name}.xacro"
        raise element.wrong(
            f"{what} is a macro of xacro, which is not expanded.\n"
            f"  fix: expand the file by `xacro {source} > {source.removesuffix('.xacro')}` and load the result; the "
            "command comes with ROS, or by pip install xacro"
        )
    for child in element.children:
        if child.tag not in ("gazebo", "transmission", "ros2_control"):
            _refuse_macros(child)


def _refuse_repeated(elements: list[Element], kind: str) -> None:
    first: dict[str, Element] = {}
    for element in elements:
        before = first.setdefault(element.text("name"), element)
        if before is not element:
            raise element.wrong(
                f"a {kind} of this name is already in line {before.line}.\n"
                "  fix: give one of the two another name, or remove it"
            )


def _look(element: Element, unused: dict[str, list[int]]) -> None:
    """Collect the unused attributes and children of an element and its descendants, with lines. Raises ModelError for
    duplicates.
    """
    kind = _VOCABULARY[element.tag]
    for name in element.attributes:
        if name not in kind.attributes.split() and not name.startswith("xmlns"):
            near = difflib.get_close_matches(name.lower(), kind.attributes.split(), 1)
            meant = f" (did you mean {near[0]!r}?)" if near else ""
            unused[f"attribute {name!r} of <{element.tag}>, which URDF does not have{meant}"].append(element.line)
    first: dict[str, Element] = {}
    for child in element.children:
        if child.tag in kind.once.split():
            before = first.setdefault(child.tag, child)
            if before is not child:
                raise child.wrong(
                    f"<{child.tag}> occurs twice in {element.head}, in line {before.line}.\n  fix: remove the wrong one"
                )
        elif child.tag not in kind.often.split():
            known = child.tag in kind.unused.split()
            unknown = "" if known else ", which URDF does not have"
            unused[f"<{child.tag}> of <{element.tag}>{unknown}"].append(child.line)
            continue
        _look(child, unused)
