"""What links of model files look like: the file's boxes, cylinders, balls and capsules, else ellipsoids."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import twistax as tx
from solutions import scene_of
from twistax.mechanics import Mechanism, load

URDF = """
<robot name="arm">
  <material name="red"><color rgba="1 0 0 0.5"/></material>
  <link name="wall"><visual><geometry><box size="0.2 1 1"/></geometry></visual></link>
  <link name="rod">{inertial}
    <visual><origin xyz="0 0 -0.5" rpy="0.3 -0.2 0.5"/><geometry><cylinder radius="0.05" length="1"/></geometry>
      <material name="red"/></visual>
    <visual><geometry><mesh filename="rod.stl"/></geometry></visual>
    <collision><geometry><sphere radius="9"/></geometry></collision>
  </link>
  <link name="tool">{inertial}
    <visual><geometry><mesh filename="tool.stl"/></geometry></visual>
    <collision><origin xyz="0 0 0.1"/><geometry><capsule radius="0.1" length="0.3"/></geometry></collision>
  </link>
  <link name="bare">{inertial}<visual><geometry><box size="1 2"/></geometry></visual></link>
  <joint name="hinge" type="continuous"><parent link="wall"/><child link="rod"/><axis xyz="0 1 0"/></joint>
  <joint name="weld" type="fixed"><parent link="rod"/><child link="tool"/><origin xyz="0 0 -1" rpy="0 0 0.4"/></joint>
  <joint name="slide" type="prismatic"><parent link="rod"/><child link="bare"/><axis xyz="1 0 0"/>
    <limit lower="0" upper="1"/></joint>
</robot>
""".replace("{inertial}", '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial>')

SOLID = """
  <inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
  <visual><origin xyz="0.1 0.2 -0.5" rpy="0.3 -0.2 0.5"/><geometry><cylinder radius="0.05" length="1"/></geometry>
  </visual>
"""
PLACED = f"""
<robot name="arm"><link name="wall"/>
  <link name="rod">{SOLID}</link><link name="tool">{SOLID}</link><link name="end">{SOLID}</link>
  <joint name="hinge" type="continuous"><parent link="wall"/><child link="rod"/><axis xyz="0 0.6 0.8"/></joint>
  <joint name="weld" type="fixed"><parent link="rod"/><child link="tool"/><origin xyz="1 0 -1" rpy="0.7 0 0.4"/></joint>
  <joint name="slide" type="prismatic"><parent link="tool"/><child link="end"/>
    <origin rpy="0 0.3 0"/><axis xyz="1 0 0"/><limit lower="0" upper="1" effort="1" velocity="1"/></joint>
</robot>
"""

MJCF = """
<mujoco><asset><material name="green" rgba="0 1 0 1"/></asset><worldbody>
  <geom name="floor" type="plane" size="1 1 0.1"/><geom type="box" size="1 2 3" pos="0 0 -3"/>
  <body name="arm" pos="0 0 1"><joint name="h" axis="0 1 0" pos="0 0 0.2"/>
    <geom type="capsule" fromto="0 0 0 0.6 0 0" size="0.05" material="green"/>
    <geom type="sphere" size="7" group="3"/>
    <body name="wrist" pos="0.6 0 0"><joint name="w"/>
      <geom type="cylinder" size="0.1 0.2" euler="90 0 0" group="4"/><geom type="ellipsoid" size="1 2 3" group="3"/>
    </body>
  </body>
</worldbody></mujoco>
"""


def in_view(path: Path, **positions: float) -> dict[str, tx.view.Body]:
    """The bodies of a mechanism at rest, by name."""
    mechanism = load(path)
    q = np.tile([positions.get(name, 0.0) for name in mechanism.joints], (2, 1))
    scene = scene_of([0.0, 1.0], {"q": q, "qd": 0.0 * q}, path.with_suffix(".none"), bodies=mechanism)
    return {body.name: body for body in scene.bodies}


@pytest.fixture(autouse=True)
def _nothing_is_written(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tx.view.Scene, "save", lambda scene, path: path)


def written(folder: Path, text: str, name: str) -> Path:
    path = folder / name
    path.write_text(text)
    return path


def test_a_urdf_file_is_drawn_as_it_says(tmp_path: Path) -> None:
    """Its visuals; where those are meshes what it collides with; where there is nothing its inertia."""
    path = written(tmp_path, URDF, "arm.urdf")
    found = in_view(path, hinge=0.5)
    kinds = {name: [type(shape).__name__ for shape in body.shapes] for name, body in found.items()}
    assert kinds == {"wall": ["Box"], "rod": ["Cylinder"], "tool": ["Capsule"], "bare": ["Ellipsoid"]}
    (rod,) = found["rod"].shapes
    np.testing.assert_allclose(rod.at[:3, :3], Rotation.from_euler("xyz", [0.3, -0.2, 0.5]).as_matrix(), atol=1e-12)
    assert (rod.at[:3, 3].tolist(), rod.radius, rod.length) == ([0.0, 0.0, -0.5], 0.05, 1.0)
    assert (rod.color, rod.opacity) == ((255, 0, 0), 0.5)
    turn = Rotation.from_euler("y", 0.5)
    np.testing.assert_allclose(found["tool"].poses[0, :3, 3], turn.apply([0.0, 0.0, -1.0]), atol=1e-6)
    np.testing.assert_allclose(
        found["tool"].poses[0, :3, :3], (turn * Rotation.from_euler("z", 0.4)).as_matrix(), atol=1e-6
    )
    assert load(path).notes == (
        "not drawn: <mesh> of <visual>, 2 times",
        "not drawn: <visual> in line 15: expected 3 finite numbers in size, got '1 2', 1 times",
    )


@pytest.mark.filterwarnings("ignore")  # of what is compiled into Pinocchio
def test_looks_are_where_pinocchio_has_them(tmp_path: Path) -> None:
    """In the world, of a link beyond a fixed joint too, in a posture with all joints moved."""
    pin = pytest.importorskip("pinocchio")
    path = written(tmp_path, PLACED, "arm.urdf")
    found = in_view(path, hinge=0.5, slide=0.3)
    model = pin.buildModelFromUrdf(str(path))
    shapes = pin.buildGeomFromUrdf(model, str(path), pin.GeometryType.VISUAL)
    data, placed = model.createData(), shapes.createData()
    q = pin.neutral(model)
    for name, value in (("hinge", [np.cos(0.5), np.sin(0.5)]), ("slide", [0.3])):
        at = model.joints[model.getJointId(name)].idx_q
        q[at : at + len(value)] = value
    pin.updateGeometryPlacements(model, data, shapes, placed, q)
    assert [shape.name for shape in shapes.geometryObjects] == ["rod_0", "tool_0", "end_0"]
    for shape, place in zip(shapes.geometryObjects, placed.oMg):
        body = found[shape.name.removesuffix("_0")]
        (own,) = body.shapes
        np.testing.assert_allclose(body.poses[0] @ own.at, place.homogeneous, atol=1e-6)
        assert (own.radius, own.length) == pytest.approx((shape.geometry.radius, 2.0 * shape.geometry.halfLength))


def test_a_floating_root_has_its_own_looks(tmp_path: Path) -> None:
    robot = load(written(tmp_path, URDF, "arm.urdf"), floating=True)
    assert [type(shape) for shape in robot.links[0].shapes] == [tx.view.Box]
    assert robot.shapes == ()


@pytest.mark.skipif(importlib.util.find_spec("mujoco") is None, reason="mujoco is not installed")
def test_an_mjcf_file_is_drawn_as_it_says(tmp_path: Path) -> None:
    """MuJoCo's half sizes and places; groups that its viewer hides only where a body has no other."""
    path = written(tmp_path, MJCF, "arm.xml")
    found = in_view(path)
    kinds = {name: [type(shape).__name__ for shape in body.shapes] for name, body in found.items() if body.shapes}
    assert kinds == {"world": ["Box"], "arm": ["Capsule"], "wrist": ["Cylinder", "Ellipsoid"]}
    (box,), (arm,) = found["world"].shapes, found["arm"].shapes
    np.testing.assert_array_equal(box.lengths, [2.0, 4.0, 6.0])
    np.testing.assert_array_equal(box.at[:3, 3], [0.0, 0.0, -3.0])
    assert (arm.radius, arm.length, arm.color) == (0.05, pytest.approx(0.6), (0, 255, 0))
    np.testing.assert_allclose(arm.at[:3, 3], [0.3, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(np.abs(arm.at[:3, 2]), [1.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(found["arm"].poses[0, :3, 3], [0.0, 0.0, 1.0], atol=1e-6)
    cylinder = found["wrist"].shapes[0]
    assert (cylinder.radius, cylinder.length) == (0.1, 0.4)
    assert "geoms that are not drawn, meshes and planes: 1" in load(path).notes


def test_a_base_looks_as_it_is_told(tmp_path: Path) -> None:
    links = load(written(tmp_path, URDF, "arm.urdf")).links
    assert Mechanism(links, base="wall", shapes=tx.view.Sphere(1.0)).shapes[0].radius == 1.0
    with pytest.raises(tx.ModelError, match="expects shapes"):
        Mechanism(links, base="wall", shapes=[3])
