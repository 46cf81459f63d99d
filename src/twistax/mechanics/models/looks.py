"""Shapes of links from the boxes, cylinders, balls, capsules and meshes of a file. Shapes that cannot be read are
noted.

Source: the pages of http://wiki.ros.org/urdf/XML/link and https://mujoco.readthedocs.io, body/geom.
"""

from __future__ import annotations

import collections
import dataclasses
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...checks import listed
from ...errors import InputError, TwistaxError
from ...view import Box, Capsule, Cylinder, Ellipsoid, Mesh, Shape, Sphere
from ...view.shapes import STEEL, Color
from ..arguments import matrix
from .mjcf_file import DrawnMesh
from .xml_file import Element

#: The last of the groups of geoms that MuJoCo's viewer draws by default.
_SHOWN = 2


@dataclasses.dataclass(frozen=True, eq=False)
class MissingMesh(Mesh):
    """Collision geometry of a file that cannot be read: its corners raise an InputError.

    Attributes:
        source: the name of a file as the model states it; empty for geometry of another kind.
        reason: why it cannot be read.
    """

    reason: str = dataclasses.field(default="", kw_only=True)

    def mesh(self) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        raise InputError(self.reason)


class FilePlane(MissingMesh):
    """The plane z = 0 at its pose, as collision geometry without corners; solid below."""


class UrdfLooks:
    """The shapes of the links of a robot: those of <visual>, or those of <collision> if none of the former can be
    drawn. The solids for distances are those of <collision>.

    Args:
        robot: the root element, whose materials are referenced by name.
        placed: a function that returns the rotation and position of an <origin>.
        folder, within: the folder of the file, and the folder in which meshes may be. Meshes are read when they are
            drawn.
    Attributes:
        notes: the parts of <visual> that are not drawn, and the links with <collision> that cannot be read.
    """

    def __init__(
        self,
        robot: Element,
        placed: Callable[[Element | None], tuple[NDArray[np.float64], NDArray[np.float64]]],
        folder: Path,
        within: Path,
    ) -> None:
        self._placed, self._left_out = placed, collections.Counter[str]()
        self._folder, self._within = folder, within
        self._unread = dict[str, None]()
        visuals = [visual for link in robot.all("link") for visual in link.all("visual")]
        self._collides = any(link.first("collision") for link in robot.all("link"))
        self._colors = dict[str, tuple[Color, float]]()
        for material in [m for place in (robot, *visuals) for m in place.all("material")]:
            color = material.first("color")
            if color is not None and "name" in material.attributes:
                self._colors[material.text("name")] = _color_of(color)

    @property
    def notes(self) -> list[str]:
        """The shapes that are not drawn, with counts, and the links without distances."""
        lines = [f"{what}, {count} times" for what, count in sorted(self._left_out.items())]
        unread = "no distances (clearances): <collision> that cannot be read, of the links"
        return [f"{unread} {listed(self._unread)}", *lines] if self._unread else lines

    def of(self, link: Element) -> tuple[Shape, ...]:
        """The shapes in the axes of the link."""
        for tag in ("visual", "collision"):  # if visual shapes are meshes, collision shapes are often simple
            shapes = [self._shape(element) for element in link.all(tag)]
            if shown := tuple(shape for shape in shapes if not isinstance(shape, MissingMesh)):
                return shown
        return ()

    def collision_of(self, link: Element) -> tuple[Shape, ...] | None:
        """The solids for distances, in the axes of the link; None if no link of the file has any."""
        if not self._collides:
            return None
        solids = tuple(self._shape(element) for element in link.all("collision"))
        if any(isinstance(solid, MissingMesh) for solid in solids):
            self._unread[link.text("name")] = None
        return solids

    def both(self, link: Element) -> dict[str, Any]:
        """The shapes and the solids for distances, as arguments of `Link`."""
        return {"shapes": self.of(link), "collision": self.collision_of(link)}

    def _shape(self, element: Element) -> Shape:
        """The shape of an element; a `MissingMesh` if it cannot be read, for <visual> with a note."""
        geometry = element.first("geometry")
        solid = geometry.children[0] if geometry is not None and geometry.children else element
        try:
            R, p = self._placed(element.first("origin"))
            color, opacity = self._looks(element.first("material"))
            looks: dict[str, Any] = {"at": matrix(R, p), "color": color, "opacity": opacity}
            if solid.tag == "box":
                return Box(solid.numbers("size", 3), **looks)
            if solid.tag == "sphere":
                return Sphere(solid.number("radius"), **looks)
            if solid.tag in ("cylinder", "capsule"):
                kind = Cylinder if solid.tag == "cylinder" else Capsule
                return kind(solid.number("radius"), solid.number("length"), **looks)
            why = f"<{solid.tag}> of <{element.tag}>"
            if solid.tag == "mesh":
                name = solid.text("filename")
                looks["scale"] = solid.numbers("scale", 3) if "scale" in solid.attributes else 1.0
                if (file := self._file(name, self._within)) is not None:
                    return Mesh(file, **looks)
                missing = MissingMesh(name, reason=self._reason(name), **looks)
            else:
                missing = MissingMesh("", reason=f"{why} is not a solid")
        except TwistaxError as error:
            what = str(error).splitlines()[0].removeprefix(f"{solid.place}: ")
            why = f"<{element.tag}> in line {element.line}: {what}"
            missing = MissingMesh("", reason=why)
        if element.tag == "visual":
            self._left_out[f"not drawn: {why}"] += 1
        return missing

    def _reason(self, name: str) -> str:
        """Why a mesh is not read, with the folder that contains its file if that is above the model's."""
        text = f"there is no file {name!r} in {str(self._within)!r}"
        folder = next((above for above in self._folder.parents if self._file(name, above)), None)
        return text if folder is None else f"{text}.\n  fix: load(..., within={str(folder)!r}), which contains it"

    def _file(self, name: str, within: Path) -> Path | None:
        """The file of a mesh; None if it does not exist, or is outside of a folder.

        `package://NAME/PATH` is PATH in a folder NAME that contains the model or is next to it; the paths of ROS
        packages are not known here.
        """
        rest = re.sub(r"^(package|file|model)://", "", name)
        inner = rest.partition("/")[2]
        folders = [self._folder, *(p for p in self._folder.parents if p.is_relative_to(within))]
        candidates = [folder / part for folder in folders for part in (rest, inner) if part]
        files = (path.resolve() for path in candidates if path.is_file())
        return next((path for path in files if path.is_relative_to(within)), None)

    def _looks(self, material: Element | None) -> tuple[Color, float]:
        color = None if material is None else material.first("color")
        if color is not None:
            return _color_of(color)
        return self._colors.get("" if material is None else material.attributes.get("name", ""), (STEEL, 1.0))


def _color_of(color: Element) -> tuple[Color, float]:
    try:
        return _painted(color.numbers("rgba", 4))
    except TwistaxError:  # invalid colours must not prevent reading the masses
        return STEEL, 1.0


def _painted(rgba: Any) -> tuple[Color, float]:
    red, green, blue, opacity = (float(x) for x in np.clip(rgba, 0.0, 1.0))
    return (round(255 * red), round(255 * green), round(255 * blue)), opacity


def looks_of_mjcf(
    model: Any, mujoco: Any, rotation: Callable[[Any], NDArray[np.float64]], drawn: Mapping[int, DrawnMesh | None]
) -> tuple[dict[int, dict[str, Any]], int]:
    """The shapes of every body, by its index and in its axes: those that MuJoCo draws, or else the hidden ones. The
    solids for distances are the geoms that may collide (contype or conaffinity); None for a file without such geoms.

    Args:
        model: a `mujoco.MjModel`.
        rotation: the matrix of a quaternion.
        drawn: the meshes that replace geoms, by the index of the geom; their files are read when they are drawn.
    Returns:
        the arguments `shapes` and `collision` of `Link`, and the number of geoms without a shape: planes.
    """
    kinds, left_out = mujoco.mjtGeom, 0
    known: dict[int, Callable[..., Shape]] = {
        int(kinds.mjGEOM_BOX): lambda a, b, c, looks: Box((2.0 * a, 2.0 * b, 2.0 * c), **looks),
        int(kinds.mjGEOM_SPHERE): lambda a, b, c, looks: Sphere(a, **looks),
        int(kinds.mjGEOM_ELLIPSOID): lambda a, b, c, looks: Ellipsoid((a, b, c), **looks),
        int(kinds.mjGEOM_CYLINDER): lambda a, b, c, looks: Cylinder(a, 2.0 * b, **looks),
        int(kinds.mjGEOM_CAPSULE): lambda a, b, c, looks: Capsule(a, 2.0 * b, **looks),
    }
    shown: dict[int, list[Shape]] = collections.defaultdict(list)
    hidden: dict[int, list[Shape]] = collections.defaultdict(list)
    solids: dict[int, list[Shape]] = collections.defaultdict(list)
    for i in range(model.ngeom):
        color, opacity = _painted(model.geom_rgba[i])
        collides = bool(model.geom_contype[i] | model.geom_conaffinity[i])
        looks: dict[str, Any] = {
            "at": matrix(rotation(model.geom_quat[i]), np.array(model.geom_pos[i])),
            "color": color,
            "opacity": opacity,
        }
        a, b, c = (float(x) for x in model.geom_size[i])
        kind, body = int(model.geom_type[i]), int(model.geom_bodyid[i])
        if mesh := drawn.get(i):
            shape: Shape = Mesh(mesh.path, scale=mesh.scale, **{**looks, "at": looks["at"] @ mesh.offset})
        elif i in drawn:
            shape = MissingMesh("", reason="a mesh that cannot be read, or a height field", **looks)
        elif kind == int(kinds.mjGEOM_MESH):
            shape = Mesh(_triangles(model, int(model.geom_dataid[i])), **looks)
        elif kind in known:
            shape = known[kind](a, b, c, looks)
        else:
            shape = FilePlane("", reason="a plane has no corners", **looks)
            left_out += opacity > 0.0
        if collides:
            solids[body].append(shape)
        if opacity > 0.0 and not isinstance(shape, MissingMesh):
            (hidden if model.geom_group[i] > _SHOWN else shown)[body].append(shape)
    both = {
        i: {"shapes": tuple(shown[i] or hidden[i]), "collision": tuple(solids[i]) if solids else None}
        for i in range(model.nbody)
    }
    return both, left_out


def _triangles(model: Any, number: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Corners and triangles of a mesh of a compiled model, in the axes of its geom."""
    corners, count = int(model.mesh_vertadr[number]), int(model.mesh_vertnum[number])
    faces, face_count = int(model.mesh_faceadr[number]), int(model.mesh_facenum[number])
    vertices = np.array(model.mesh_vert[corners : corners + count], dtype=np.float64)
    return vertices, np.array(model.mesh_face[faces : faces + face_count], dtype=np.int64)
