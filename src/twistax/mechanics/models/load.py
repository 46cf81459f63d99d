"""A mechanism from a file in one line."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from pathlib import Path

from ...checks import path_of
from ...errors import ModelError
from ...expr.fields import ExprLike
from ..mechanism import Mechanism
from .choices import Choices
from .urdf import Urdf
from .xml_file import read_xml


def load(
    path: str | Path,
    *,
    floating: bool = False,
    parameters: bool | Iterable[str] = False,
    keep: Collection[str] = (),
    gravity: ExprLike = (0.0, 0.0, -9.81),
    physical: bool = True,
    quarter_turns: float = 1e-9,
) -> Mechanism:
    """The mechanism that a URDF file describes.

    Meshes are not needed and no other file is opened. `mechanism.notes` says what the file has that is not used.

    Args:
        path: of the file.
        floating: the root link is free in space, on a joint "root"; else it is at rest.
        parameters: True, or names, of numbers that become Parameters with the file's values: `<link>_mass`,
            `<link>_center_of_mass` (3,), `<link>_inertia` (3, 3) about it, `<joint>_origin` (3,), `<joint>_axis` (3,),
            `<joint>_damping`, `<joint>_friction`. Other values compile nothing anew.
        keep: names of fixed joints that are not merged, as for `Mechanism`.
        gravity: (3,), m/s2, in the base's axes.
        physical: refuse a mass or inertia that no body has; False takes it as it is and says so in the notes.
        quarter_turns: angles of origins this near to a multiple of a quarter turn, rad, are taken as that: files write
            1.57079632679. Zero takes them as they are written.
    Raises: ModelError with file, line and element.
    """
    root = read_xml(path_of("load: path", path))
    if root.tag != "robot":
        raise root.wrong("load expects a URDF file, whose root is <robot>")
    choices = Choices(parameters)
    model = Urdf(root, choices, floating=floating, physical=physical, quarter_turns=quarter_turns)
    choices.check()
    try:
        return Mechanism(model.links, gravity, base=model.base, keep=keep, notes=model.notes)
    except ModelError as error:
        raise root.wrong(str(error)) from None
