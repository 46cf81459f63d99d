"""Meshes that an MJCF model only draws: where MuJoCo puts their corners, without an effect on masses."""

import importlib.util
import struct
from pathlib import Path

import numpy as np
import pytest

import twistax as tx
from twistax.mechanics import load

pytestmark = [
    pytest.mark.skipif(importlib.util.find_spec("mujoco") is None, reason="mujoco is not installed"),
    pytest.mark.skipif(importlib.util.find_spec("trimesh") is None, reason="trimesh is not installed"),
]
CORNERS = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
INERTIAL = '<inertial pos="0 0 -0.5" mass="2" diaginertia="0.1 0.2 0.25"/>'
ARM = """<mujoco><compiler meshdir="meshes" angle="degree"/>
  <default><default class="visual"><geom type="mesh" contype="0" conaffinity="0" group="2" euler="0 0 30"/></default>
  </default>
  <asset><mesh name="rod" file="rod.stl" {mesh}/><mesh name="gone" file="gone.stl"/>
    <material name="red" rgba="0.9 0.1 0.1 1"/></asset>
  <worldbody><body name="arm" pos="0 0 1"><joint axis="0 1 0"/>{inertial}
    <frame pos="0.1 0.2 0.3" euler="10 20 0">
      <geom class="visual" mesh="rod" pos="0 0 0.5" material="red" {geom}/></frame>
    {more}</body></worldbody></mujoco>"""


def write(folder: Path, **parts: str) -> Path:
    """A model and its mesh, binary STL by its specification."""
    (folder / "meshes").mkdir(exist_ok=True)
    triangles = b"".join(struct.pack("<12fH", *([0.0] * 3), *CORNERS[face].ravel(), 0) for face in FACES)
    (folder / "meshes" / "rod.stl").write_bytes(bytes(80) + struct.pack("<I", len(FACES)) + triangles)
    path = folder / "arm.xml"
    path.write_text(ARM.format(**{"mesh": "", "geom": "", "more": "", "inertial": INERTIAL, **parts}))
    return path


def corners_by_mujoco(path: Path) -> np.ndarray:
    """The corners of the first mesh geom in the axes of its body, as MuJoCo compiles the whole file."""
    import mujoco

    text = path.read_text().replace('<mesh name="gone" file="gone.stl"/>', "")
    spec = mujoco.MjSpec.from_string(text)
    spec.modelfiledir = str(path.parent)
    model = spec.compile()
    (geom,) = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_MESH)
    mesh, R = model.geom_dataid[geom], np.zeros(9)
    first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    mujoco.mju_quat2Mat(R, model.geom_quat[geom])
    return model.mesh_vert[first : first + count] @ R.reshape(3, 3).T + model.geom_pos[geom]


def rounded(corners: np.ndarray) -> set[tuple[float, ...]]:
    return {tuple(np.round(corner, 4) + 0.0) for corner in corners}


@pytest.mark.parametrize(
    "mesh",
    [
        "",
        'scale="0.5 2 -1"',
        'refpos="0.1 -0.2 0.3" scale="0.5 2 1"',
        'refpos="0.1 -0.2 0.3" refquat="0.8 0.2 -0.4 0.4" scale="0.5 0.5 0.5"',
    ],
)
def test_a_mesh_that_is_only_drawn_is_where_mujoco_has_it(tmp_path: Path, mesh: str) -> None:
    path = write(tmp_path, mesh=mesh)
    (link,) = load(path).links
    (rod,) = link.shapes
    assert isinstance(rod, tx.view.Mesh)
    np.testing.assert_allclose(rod.color, (229.5, 25.5, 25.5), atol=0.6)
    assert rounded(rod.corners()) == rounded(corners_by_mujoco(path))


def test_it_changes_no_mass_and_is_opened_when_it_is_drawn(tmp_path: Path) -> None:
    path = write(tmp_path)
    drawn = load(path)
    (tmp_path / "meshes" / "rod.stl").write_bytes(b"not a mesh")
    (link,) = load(path).links
    with pytest.raises(tx.InputError, match=r"rod\.stl"):
        link.shapes[0].mesh()
    (tmp_path / "meshes" / "rod.stl").unlink()
    without = load(path)
    assert without.links[0].shapes == ()
    assert "geoms of meshes and height fields: 1" in without.notes
    np.testing.assert_array_equal(*(robot.links[0].body.inertia.value for robot in (drawn, without)))
    assert drawn.links[0].body.mass.value == 2.0


def test_a_mesh_without_mass_needs_no_file_in_a_body_whose_mass_follows_from_geoms(tmp_path: Path) -> None:
    """`mass="0"` and `density="0"` are the ways to say that a geom is only drawn."""
    more = '<geom type="sphere" size="0.1" mass="3"/>'
    for geom in ('mass="0"', 'density="0"'):
        path = write(tmp_path, inertial="", geom=geom, more=more)
        (tmp_path / "meshes" / "rod.stl").write_bytes(b"not a mesh")
        (link,) = load(path).links
        assert [type(shape) for shape in link.shapes] == [tx.view.Mesh, tx.view.Sphere]
        assert link.body.mass.value == pytest.approx(3.0)
        np.testing.assert_allclose(link.body.inertia.value, np.eye(3) * 0.4 * 3.0 * 0.01, rtol=1e-9)


def test_collision_meshes_are_hidden_behind_visual_ones(tmp_path: Path) -> None:
    """By convention groups above 2 are for collisions: they are drawn where a body has nothing else."""
    collision = '<geom type="mesh" mesh="rod" group="3"/>'
    assert len(load(write(tmp_path, more=collision)).links[0].shapes) == 1
    assert len(load(write(tmp_path, geom='group="3"', more=collision)).links[0].shapes) == 2


def test_what_cannot_be_drawn_is_noted(tmp_path: Path) -> None:
    """A file that is not there, a shape fitted to a mesh, a file outside of the folder."""
    more = '<geom class="visual" mesh="gone"/><geom type="box" mesh="rod" contype="0" conaffinity="0"/>'
    robot = load(write(tmp_path, more=more))
    assert len(robot.links[0].shapes) == 1
    assert "geoms of meshes and height fields: 2" in robot.notes
    folder = tmp_path / "inner"
    folder.mkdir()
    path = write(folder)
    path.write_text(path.read_text().replace('file="rod.stl"', 'file="../../meshes/rod.stl"'))
    assert load(path).links[0].shapes == ()
    assert len(load(path, within=tmp_path).links[0].shapes) == 1
