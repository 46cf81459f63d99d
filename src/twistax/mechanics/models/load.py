"""A mechanism from a file in one line."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path

from ...checks import path_of
from ...errors import ModelError
from ...expr.fields import ExprLike
from ...progress import watching
from ..mechanism import Mechanism
from .choices import Choices
from .mjcf import Mjcf
from .urdf import Urdf
from .xml_file import Element, read_xml


@watching("load")
def load(
    path: str | Path,
    *,
    floating: bool = False,
    parameters: bool | Iterable[str] = False,
    keep: Collection[str] = (),
    gravity: ExprLike | None = None,
    physical: bool | Mapping[str, bool] | None = None,
    quarter_turns: float = 1e-9,
    within: str | Path | None = None,
) -> Mechanism:
    """Load the mechanism that a file describes, in URDF or MJCF; the root element determines the format.

    MJCF is compiled by MuJoCo (`pip install twistax[models]`). `solution.show` draws boxes, cylinders, balls, capsules,
    and meshes whose files exist. `mechanism.notes` lists parts of the file that are not used, such as missing meshes or
    unknown attributes, and the conventions that were applied. Nothing in a file is executed. Meshes are opened when
    they are drawn or used in distances. Included files of MJCF, and meshes that determine a mass, are opened when the
    model is loaded.

    Masses and inertias are checked. Links that are fixed together count as one body. A moving body whose mass or a
    principal moment is not positive raises an error, because the equations of motion may have no unique solution.
    `notes` lists unphysical links in a body that does not move, or that is physical as a whole, and bodies with one
    principal moment above the sum of the other two, which are frequent in files from identification or CAD.

    Args:
        path: path of the file.
        floating: for URDF, whether the root link moves freely, on a joint "root" ("root (2)" if the file has that
            name); by default it is fixed. In MJCF the file determines it.
        parameters: True, or names, of the numbers that become Parameters with the file's values: `<link>_mass`,
            `<link>_center_of_mass` (3,), `<link>_inertia` (3, 3) about the centre of mass, `<joint>_origin` (3,),
            `<joint>_axis` (3,), `<joint>_damping`, `<joint>_friction`. For MJCF, `<body>_origin` replaces that of the
            joint, and there are also `<joint>_armature` and `<joint>_stiffness`, without the contribution of a servo.
            Other values of Parameters do not recompile. A mass of zero remains a number.
        keep: names of fixed joints that are not merged, as for `Mechanism`.
        gravity: (3,), m/s2, in the base's axes; by default that of the file, or 9.81 downwards along z.
        physical: True raises an error for every moving body that is not physical, False accepts all masses and
            inertias. `{"tool": False}` applies to the link "tool" alone.
        quarter_turns: tolerance, rad, within which angles of origins are rounded to a multiple of a quarter turn,
            because files write 1.57079632679. In MJCF it applies to entries of rotation matrices. Zero disables
            rounding.
        within: a folder that contains the file. Other files are opened only in this folder or below it, after symbolic
            links are resolved; by default the folder of the file.
    Raises: ModelError with file, line and element.

    Example:
        `arm = tx.mechanics.load("panda.urdf")`; `dynamics = tx.compile(arm.system())`.
        `load("robots/arm/scene.xml", within="robots")` reads a scene that includes `../parts/gripper.xml`.
    """
    path, notes = path_of("load: path", path), list[str]()
    root = read_xml(path, notes=notes)
    choices = Choices(parameters, physical)
    folder = _folder(root, within)
    try:
        model = _read(root, choices, floating, quarter_turns, folder)
        choices.finish()
        if choices.doubts:
            plain = model if choices.wanted is False else _read(root, Choices(False), floating, quarter_turns, folder)
            choices.judge(plain.links, plain.base)
        return Mechanism(
            model.links,
            model.gravity if gravity is None else gravity,
            base=model.base,
            keep=keep,
            notes=[*notes, *choices.notes, *model.notes],
            driven=model.driven,
            loops=model.loops,
            shapes=model.shapes,
            collision=model.collision,
            base_body=model.base_body,
        )
    except ModelError as error:
        placed = re.match(r"load|.*, line \d+, <", str(error))
        raise error if placed else root.wrong(str(error)) from None


def _folder(root: Element, within: str | Path | None) -> Path:
    """The folder within which other files may be opened. Raises ModelError if the file is not in it."""
    file_folder = root.path.resolve().parent
    if within is None:
        return file_folder
    folder = path_of("load: within", within).resolve()
    if not file_folder.is_relative_to(folder):
        raise ModelError(f"load: within expects a folder that {str(root.path)!r} is in, got {str(within)!r}")
    return folder


def _read(root: Element, choices: Choices, floating: bool, quarter_turns: float, folder: Path) -> Urdf | Mjcf:
    if root.tag == "robot":
        return Urdf(root, choices, floating=floating, quarter_turns=quarter_turns, folder=folder)
    if root.tag == "mujoco" and floating:
        raise root.wrong(
            "floating=True is for URDF; an MJCF file declares its free bodies.\n  fix: write <freejoint/> into the body"
        )
    if root.tag == "mujoco":
        return Mjcf(root, choices, quarter_turns=quarter_turns, folder=folder)
    raise root.wrong("load expects URDF, whose root is <robot>, or MJCF, whose root is <mujoco>")
