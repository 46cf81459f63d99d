"""Model files: errors with name and line, notes, the resulting motion, and the folder restriction."""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import twistax as tx

from ...mechanics import Mechanism, load
from ..harness.expected import at_most, needed, refused
from ..harness.measurement import MeasuredCase, Section, quick

#: A rod on a hinge in URDF: its inertial and its joint.
_INERTIAL = '<inertial><mass value="2"/><inertia ixx="{}" iyy="{}" izz="{}" ixy="0" ixz="0" iyz="0"/></inertial>'
_ROD = _INERTIAL.format(3, 2, 2)
_HINGE = '<joint name="hinge" type="continuous"><parent link="base"/><child link="rod"/><axis xyz="0 0 1"/></joint>'
_BASE = '<link name="base"/>'


def _robot(*parts: str, **options: Any) -> Mechanism:
    """The mechanism that `load` reads from a file of these lines."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "robot.urdf"
        path.write_text("\n".join(("<robot name='r'>", *parts, "</robot>")))
        return load(path, **options)


def _link(inside: str) -> str:
    return f'<link name="rod">{inside}</link>'


def _loaded(*parts: str, **options: Any) -> float:
    """1 for a file that loads. Raises what `load` raises."""
    return float(isinstance(_robot(*parts, **options), Mechanism))


def _noted(*moments: float) -> float:
    """How far a free link with these moments is from Newton and Euler, rad/s2; NaN unless its note has them."""
    robot = _robot(_link(_INERTIAL.format(*moments)), floating=True)
    listed = ", ".join(f"{moment:g}" for moment in sorted(moments))
    if not any("'rod' has" in note and f"principal moments {listed} kg m2" in note for note in robot.notes):
        return float("nan")
    tensor = np.diag(moments)
    w, torque = np.array([0.3, -0.7, 0.5]), np.array([1.0, 2.0, -3.0])
    V, F = (np.concatenate([np.zeros(3), part]) for part in (w, torque))
    turning = np.asarray(tx.lower(robot.bodies[0].acceleration(V, F))(0.0))[3:]
    return float(np.abs(turning - np.linalg.solve(tensor, torque - np.cross(w, tensor @ w))).max())


def _beside(within: bool) -> float:
    """The error of the mass of a scene that includes a file of the folder beside it, kg."""
    needed("mujoco", "twistax[models]")
    with tempfile.TemporaryDirectory() as folder:
        parts, scenes = Path(folder) / "parts", Path(folder) / "scenes"
        for subfolder in (parts, scenes):
            subfolder.mkdir()
        body = "<body><joint/><geom size='0.1' mass='2.5'/></body>"
        (parts / "arm.xml").write_text(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
        scene = scenes / "scene.xml"
        scene.write_text("<mujoco><include file='../parts/arm.xml'/></mujoco>")
        robot = load(scene, within=folder if within else None)
        return abs(float(np.asarray(tx.lower(tx.mechanics.total_mass(robot))(0.0))) - 2.5)


def _refused(what: str, words: str, *parts: str, **options: Any) -> MeasuredCase:
    return quick(what, "load", refused(tx.ModelError, words), _loaded, *parts, **options)


_BOUND, _OUTSIDE = at_most(1e-14, "rad/s2"), refused(tx.ModelError, "outside of the folder")

FILES: Section = [
    "What a file says twice or does not say is refused with file, line and element.",
    _refused("two links of one name", "line 4, <link name='rod'>", _BASE, _link(_ROD), _link(_ROD), _HINGE),
    _refused("two inertias of one link", "<inertial> occurs twice", _BASE, _link(_ROD + _ROD), _HINGE),
    _refused("macros that are not expanded", "<xacro:leg> is a macro", _BASE, _link(_ROD), _HINGE, "<xacro:leg/>"),
    "An inertia with which accelerations are not determined is refused, one that merely no body has is noted.",
    _refused(
        "principal moments -1, 2, 2 kg m2", "not negative", _BASE, _link(_INERTIAL.format(-1, 2, 2)), _HINGE
    ),
    quick("principal moments 1, 1, 5 kg m2: noted, apart from Newton and Euler", "load", _BOUND, _noted,
          5.0, 1.0, 1.0),
    _refused("the same with physical=True", "above the sum", _BASE, _link(_INERTIAL.format(5, 1, 1)), _HINGE,
             physical=True),
    "Other files are read in the folder of the model, or in the one that is named.",
    quick("a scene that includes a file of another folder", "load", _OUTSIDE, _beside, False),
    quick("the same with within=: its mass", "load", at_most(0, "kg"), _beside, True),
]  # fmt: skip
