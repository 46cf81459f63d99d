"""MJCF by MuJoCo's compiler: the files that it may open are restricted, and its errors are reported with file and line.

The file is first parsed by `read_xml`, so entities are not expanded. Included files are inserted; they must be in the
folder of the model or below it. Content that could run code, or open files that are not checked, is refused.
"""

from __future__ import annotations

import collections
import dataclasses
import os
import re
import warnings
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from ...errors import ModelError
from .xml_file import Element, read_xml

#: Elements that are refused, with the reasons.
_REFUSED = {
    "extension": "plugins run code of their own",
    "plugin": "plugins run code of their own",
    "model": "models inside of models are not read.\n  fix: write them as <include>",
    "attach": "models inside of models are not read.\n  fix: write them as <include>",
    "flexcomp": "deformable bodies are not read",
    "flex": "deformable bodies are not read",
}
#: The maximal nesting depth of elements, which are processed recursively.
_DEEPEST = 200


def compiler(element: Element) -> Any:
    """The module `mujoco`. Raises ModelError if it is not installed."""
    try:
        import mujoco
    except ImportError:
        raise element.wrong(
            "MJCF is read by MuJoCo's compiler, which is not installed.\n  fix: pip install twistax[models]"
        ) from None
    return mujoco


#: Formats of meshes that can be drawn, and that MuJoCo also reads.
DRAWN_MESHES = {".stl", ".obj"}
#: The radius of the sphere that replaces a mesh that is only drawn, m.
_TINY = 1e-6


@dataclasses.dataclass(frozen=True)
class DrawnMesh:
    """A mesh that does not affect any mass; its file is read when it is drawn.

    Attributes:
        path: path of the file.
        scale: factors of its coordinates.
        offset: pose (4, 4) of its axes in those of the geom.
    """

    path: Path
    scale: tuple[float, float, float]
    offset: NDArray[np.float64]


class Compiled:
    """A file compiled by MuJoCo, without the parts that do not affect the dynamics.

    Args:
        root: the element <mujoco>.
        folder: the folder in which included files and meshes may be; it contains the file.
    Attributes:
        model: the `mujoco.MjModel`.
        warnings: MuJoCo's.
        left_out: the number of elements that were removed before compiling, by kind.
        drawn: meshes that are only drawn, by the index of the tiny massless sphere that replaces the geom; None for
            meshes that cannot be read and height fields.
    Raises: ModelError with file, line and element.
    """

    def __init__(self, root: Element, folder: Path) -> None:
        mujoco = compiler(root)
        self.left_out = collections.Counter[str]()
        self._folder, self._within = root.path.resolve().parent, folder.resolve()
        self._opened = dict[str, Element]()
        drawn = list[tuple[Any, DrawnMesh | None]]()
        self._root, self._elements, self._read = root, list[Element](), {root.path.resolve()}
        text = self._written(self._with_included(root))
        try:
            spec = mujoco.MjSpec.from_string(text)
            spec.modelfiledir = str(self._folder)
            self._lighten(spec, mujoco, drawn)
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                self.model = spec.compile()
        except ModelError:
            raise
        except ValueError as error:
            raise self._said(str(error)) from None
        self.drawn = {geom.id: mesh for geom, mesh in drawn}
        self.warnings = [f"MuJoCo warns: {str(warning.message).strip()}" for warning in caught]

    def _with_included(self, element: Element, depth: int = 0) -> Element:
        """The element with included files inserted. Raises ModelError for a file that must not be read."""
        if element.tag in _REFUSED and (element.tag != "model" or "file" in element.attributes):
            raise element.wrong(_REFUSED[element.tag])
        if depth > _DEEPEST:
            raise element.wrong(f"elements are nested more than {_DEEPEST} deep")
        for name, value in element.attributes.items():
            if name != "name" and "nan" in value.lower().split():
                raise element.wrong(f"expected finite numbers in {name}, got {value!r}")
        children = list[Element]()
        for child in element.children:
            # Memory sizes concern users and simulations; the dynamics need none.
            if child.tag == "size":
                continue
            if child.tag != "include":
                children.append(self._with_included(child, depth + 1))
                continue
            path = self._inside(child, child.text("file"))
            if path in self._read:
                raise child.wrong(f"{path.name!r} is included twice, or includes itself")
            self._read.add(path)
            children += self._with_included(read_xml(path), depth).children
        element.children = children
        return element

    def element(self, tag: str, name: str) -> Element:
        """The element with a tag and a name; the root if there is none."""
        named = (e for e in self._elements if e.tag == tag and name and e.attributes.get("name") == name)
        return next(named, self._root)

    def _inside(self, element: Element, name: str, start: str = "") -> Path:
        """The path of a file that an element names, after symbolic links are resolved. Raises ModelError for a file
        that must not be read.
        """
        try:
            path = (self._folder / start / name).resolve()
        except (OSError, RuntimeError, ValueError) as error:  # a cycle of links, or a null character
            raise element.wrong(f"{name!r} is not a path of a file: {error}") from None
        if not path.is_relative_to(self._within):
            common = Path(os.path.commonpath([path, self._within]))
            raise element.wrong(
                f"the file {name!r} lies outside of the folder {self._within.name!r}, in which files are read.\n"
                f"  fix: load(..., within={str(common)!r}) if all files in that folder may be read, or move the file"
            )
        return path

    def _written(self, element: Element) -> str:
        """The text of an element. Every element begins a new line, whose number is the element's index in a list."""
        self._elements.append(element)
        head = " ".join([element.tag, *(f"{name}={quoteattr(value)}" for name, value in element.attributes.items())])
        inner = "".join(self._written(child) for child in element.children)
        return f"<{head}>\n{inner.removesuffix(chr(10))}</{element.tag}>\n" if inner else f"<{head}/>\n"

    def _said(self, message: str) -> ModelError:
        """An error with MuJoCo's message and the location in the file."""
        at = re.search(r"line (\d+)", message)
        element = self._elements[int(at[1]) - 1] if at else self._about(message)
        return element.wrong(re.sub(r"^(XML )?Error:\s*", "", message.strip()).splitlines()[0])

    def _about(self, text: str) -> Element:
        """The element whose file a text names, the one with the longest name if there are several."""
        names = [(element.attributes.get("file", ""), element) for element in self._elements]
        inside = [(len(name), element) for name, element in (*names, *self._opened.items()) if name and name in text]
        return max(inside, key=lambda pair: pair[0], default=(0, self._root))[1]

    def _lighten(self, spec: Any, mujoco: Any, drawn: list[tuple[Any, DrawnMesh | None]]) -> None:
        """Remove elements that do not affect the dynamics, so that their meshes need not exist."""
        for kind, elements in (
            ("sensors", spec.sensors),
            ("keyframes", spec.keys),
            ("tuples", spec.tuples),
            ("contact pairs", spec.pairs),
            ("contact exclusions", spec.excludes),
            ("skins", spec.skins),
        ):
            self._delete(spec, kind, elements)
        joints = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
        not_of_joints = [actuator for actuator in spec.actuators if actuator.trntype not in joints]
        self._delete(spec, "actuators of tendons, sites and bodies", not_of_joints)
        of_tendons = [equality for equality in spec.equalities if equality.type == mujoco.mjtEq.mjEQ_TENDON]
        self._delete(spec, "equalities of tendons", of_tendons)
        self._delete(spec, "tendons", spec.tendons)
        needed = set[str]()
        self._without_shapes(spec, mujoco, spec.worldbody, False, needed, drawn)
        for mesh in list(spec.meshes):
            if mesh.name not in needed:
                spec.delete(mesh)
            elif mesh.file:  # the resolved path is the one that is opened
                element = self._about(mesh.file)
                mesh.file = str(self._inside(element, mesh.file, spec.meshdir or ""))
                self._opened[mesh.file] = element
        for named in [*spec.geoms, *spec.sites]:
            material = spec.material(named.material) if named.material else None
            if material is not None:  # the element is removed before geoms are drawn
                named.rgba = material.rgba
            named.material = ""
        for asset in [*spec.materials, *spec.textures, *spec.hfields]:
            spec.delete(asset)

    def _without_shapes(
        self,
        spec: Any,
        mujoco: Any,
        body: Any,
        is_moving: bool,
        needed: set[str],
        drawn: list[tuple[Any, DrawnMesh | None]],
    ) -> None:
        """Replace geoms that refer to files, except those that determine the mass of a moving body, by tiny spheres, so
        that MuJoCo computes their poses without the files.
        """
        by_geoms = spec.compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
        first, last = spec.compiler.inertiagrouprange
        is_moving = is_moving or bool(body.joints)
        for geom in list(body.geoms):
            if geom.type != mujoco.mjtGeom.mjGEOM_HFIELD and not geom.meshname:
                continue
            has_mass = geom.mass != 0.0 and (not np.isnan(geom.mass) or geom.density != 0.0)
            if is_moving and (by_geoms or not body.explicitinertial) and has_mass and first <= geom.group <= last:
                needed.add(geom.meshname)
                continue
            mesh = self._drawn_mesh(spec, mujoco, geom.meshname) if geom.meshname else None
            if mesh is None or geom.type != mujoco.mjtGeom.mjGEOM_MESH:
                self.left_out["geoms of meshes and height fields"] += 1
                mesh = None
            drawn.append((geom, mesh))
            geom.type, geom.mass, geom.size = mujoco.mjtGeom.mjGEOM_SPHERE, 0.0, [_TINY] * 3
            geom.meshname = geom.hfieldname = ""
        for child in body.bodies:
            self._without_shapes(spec, mujoco, child, is_moving, needed, drawn)

    def _drawn_mesh(self, spec: Any, mujoco: Any, name: str) -> DrawnMesh | None:
        """A mesh whose file may be read, exists, and has a format that can be drawn; else None."""
        mesh = spec.mesh(name)
        if mesh is None or Path(mesh.file).suffix.lower() not in DRAWN_MESHES:
            return None
        try:
            path = self._inside(self._about(mesh.file), mesh.file, spec.meshdir or "")
        except ModelError:
            return None
        # MuJoCo translates vertices by -refpos, rotates them by the inverse of refquat and scales them, in this order.
        scale, entries = np.array(mesh.scale), np.zeros(9)
        mujoco.mju_quat2Mat(entries, np.array(mesh.refquat) / np.linalg.norm(mesh.refquat))
        inverse = entries.reshape(3, 3).T
        is_uniform = bool(np.all(scale == scale[0]))
        if not path.is_file() or not (is_uniform or np.array_equal(inverse, np.eye(3))):
            return None
        offset = np.eye(4)
        offset[:3, :3], offset[:3, 3] = inverse, -scale * (inverse @ np.array(mesh.refpos))
        return DrawnMesh(path, (float(scale[0]), float(scale[1]), float(scale[2])), offset)

    def _delete(self, spec: Any, kind: str, elements: Any) -> None:
        deleted = list(elements)
        for element in deleted:
            spec.delete(element)
        if deleted:
            self.left_out[kind] += len(deleted)
