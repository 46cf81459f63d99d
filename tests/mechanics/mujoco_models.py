"""MuJoCo's model of a file, compiled as `mechanics.load` has it compiled."""

from pathlib import Path
from typing import Any

from twistax.mechanics.models.mjcf_file import Compiled
from twistax.mechanics.models.xml_file import read_xml


def mujoco_model(path: Path, folder: Path | None = None) -> Any:
    """The `mujoco.MjModel`, without looks. Included files lie in the folder, by default that of the file."""
    return Compiled(read_xml(path), folder or path.parent).model
