"""Distances of the links of robots from files: their geometry, their pairs, and Pinocchio with Coal."""

import importlib.util
import itertools
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import jax
import numpy as np
import pytest

import twistax as tx
from evaluated import evaluated
from twistax import mechanics
from twistax.mechanics import ConvexPolytope, Link, Mechanism, clearances, joints, signed_distance
from twistax.view import Box, Sphere

HAS_PINOCCHIO = importlib.util.find_spec("pinocchio") is not None
URDF = """<robot name="arm">
  <link name="base"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>
  <link name="rod">{inertial}</link>
  <link name="hand">{inertial}<visual><geometry><box size="1 1 1"/></geometry></visual>
    <collision><origin xyz="0 0 0.5"/><geometry><sphere radius="0.2"/></geometry></collision></link>
  <link name="tip">{inertial}<visual><geometry><box size="1 1 1"/></geometry></visual></link>
  <link name="tool">{inertial}<collision><origin xyz="0 0 0.4"/><geometry>{mesh}</geometry></collision></link>
  <joint name="a" type="continuous"><parent link="base"/><child link="rod"/><origin xyz="0 0 1"/></joint>
  <joint name="b" type="continuous"><parent link="rod"/><child link="hand"/><origin xyz="0 0 1"/></joint>
  <joint name="c" type="continuous"><parent link="hand"/><child link="tip"/><origin xyz="0 0 1"/></joint>
  <joint name="d" type="continuous"><parent link="tip"/><child link="tool"/><origin xyz="0 0 1"/></joint>
</robot>"""
INERTIAL = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial>'
MESH = '<mesh filename="package://arm/meshes/tool.obj" scale="0.5 0.5 0.5"/>'


def written(folder: Path, mesh: str = MESH) -> Path:
    """A package with a URDF file and the mesh of a cube of 2 m."""
    (folder / "arm" / "meshes").mkdir(parents=True, exist_ok=True)
    (folder / "arm" / "urdf").mkdir(exist_ok=True)
    corners, faces = Box((2.0, 2.0, 2.0)).mesh()
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces]
    (folder / "arm" / "meshes" / "tool.obj").write_text("\n".join(lines))
    path = folder / "arm" / "urdf" / "arm.urdf"
    path.write_text(URDF.format(inertial=INERTIAL, mesh=mesh))
    return path


def test_collision_geometry_of_a_urdf_file(tmp_path: Path) -> None:
    pytest.importorskip("trimesh")
    path = written(tmp_path)
    arm = mechanics.load(path, within=tmp_path)
    pairs = clearances(arm)
    gaps = {frozenset(name.split("-")): d for name, d in evaluated(pairs, {"q": np.zeros(4)}).items()}
    assert len(pairs) == 3
    assert np.isclose(gaps[frozenset(("base", "hand"))], 2.5 - 0.3)
    assert np.isclose(gaps[frozenset(("base", "tool"))], 4.4 - 0.6)  # the cube has an edge of 1 m
    assert np.isclose(gaps[frozenset(("hand", "tool"))], 4.4 - 2.5 - 0.7)
    (tmp_path / "again.urdf").write_text(arm.to_urdf())
    read = mechanics.load(tmp_path / "again.urdf")
    assert clearances(read).keys() == pairs.keys()
    assert np.array_equal(read.link("tool").collision[0].corners(), arm.link("tool").collision[0].corners())


def test_collision_geometry_follows_edits(tmp_path: Path) -> None:
    arm = mechanics.load(written(tmp_path, '<sphere radius="0.1"/>'))
    first, second = arm.renamed("left_"), arm.renamed("right_")
    names = {name for pair in clearances(first.attach(second, "left_tool")) for name in pair.split("-")}
    assert names == {f"{side}_{name}" for side in ("left", "right") for name in ("base", "hand", "tool")}
    assert {name for pair in clearances(arm.rerooted("tool")) for name in pair.split("-")} == {"base", "hand", "tool"}
    tool = Link(joints.Revolute("e", (0.0, 0.0, 1.0)), None, np.eye(4), name="ball", shapes=[Sphere(0.1)])
    both = arm.attach(Mechanism([tool], base="stand"), "rod")
    assert {"ball", "hand"} <= {name for pair in clearances(both) for name in pair.split("-")}
    (tmp_path / "both.urdf").write_text(both.to_urdf())
    assert clearances(mechanics.load(tmp_path / "both.urdf")).keys() == clearances(both).keys()


def test_geometry_that_cannot_be_read_is_an_error(tmp_path: Path) -> None:
    arm = mechanics.load(path := written(tmp_path))
    assert any("'tool'" in note and "<collision>" in note for note in arm.notes)
    with pytest.raises(tx.ModelError, match=r"(?s)links 'tool' cannot be used.*arm/meshes/tool.obj") as caught:
        clearances(arm)
    folder = str(caught.value).partition("within='")[2].partition("'")[0]
    assert folder == str(path.parents[1])
    assert any("tool" in name for name in clearances(mechanics.load(path, within=folder)))
    assert set(clearances(arm, {"hand": Sphere(0.1), "base": Sphere(0.1)})) == {"hand-base"}
    for mesh, reason in (
        ("", "<collision> of <collision>"),
        ('<box size="1 2"/>', "3 finite numbers"),
        (MESH.replace("tool", "gone"), "gone.obj"),
    ):
        with pytest.raises(tx.ModelError, match=reason):
            clearances(mechanics.load(written(tmp_path, mesh), within=tmp_path))


def test_fast_functions_call_the_search_once() -> None:
    """The loops of the search are not parts of the function."""
    hull = ConvexPolytope(np.random.default_rng(0).normal(size=(8, 3)))
    gap = tx.lower(signed_distance(hull, Sphere(0.1), None, tx.State("T", (4, 4))))
    parts = tx.fast(lambda T: gap(0.0, {"T": T})).explain(np.eye(4))
    assert len(parts.splitlines()) == 1, parts


def test_collision_geometry_of_an_mjcf_file(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    text = """<mujoco><asset><mesh name="gone" file="gone.stl"/></asset><worldbody>
      <geom type="plane" size="1 1 1"/>
      <body name="a" pos="0 0 1"><joint/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
        <geom type="box" size="1 1 1" contype="0" conaffinity="0"/>
        <geom type="sphere" size="0.1" group="3" rgba="0 0 0 0"/>
      <body name="b" pos="0 0 1"><joint/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
        <geom type="box" size="1 1 1" contype="0" conaffinity="0"/>
        <geom type="mesh" mesh="gone" contype="{kind}" conaffinity="0"/>
      <body name="c" pos="0 0 1"><joint/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
        <geom type="sphere" size="0.2"/></body></body></body></worldbody></mujoco>"""
    (tmp_path / "arm.xml").write_text(text.format(kind=0))
    arm = mechanics.load(tmp_path / "arm.xml")
    assert all(isinstance(shape, Box) for shape in (*arm.link("a").shapes, *arm.link("b").shapes))
    gaps = evaluated(clearances(arm), {"q": np.zeros(3)})
    assert {frozenset(name.split("-")): value for name, value in gaps.items()} == pytest.approx(
        {frozenset(("a", "c")): 2.0 - 0.3, frozenset(("world", "c")): 3.0 - 0.2}
    )
    (tmp_path / "arm.xml").write_text(text.format(kind=1))
    with pytest.raises(tx.ModelError, match="'b' cannot be used"):
        clearances(mechanics.load(tmp_path / "arm.xml"))


# ---- Pinocchio and Coal ----------------------------------------------------------------------------------------------

SHARE = Path(importlib.util.find_spec("pinocchio").origin).parents[4] / "share" if HAS_PINOCCHIO else Path()
ROBOTS = SHARE / "example-robot-data" / "robots"
needs_robots = pytest.mark.skipif(not ROBOTS.is_dir(), reason="example-robot-data is not installed")


def named(name: str) -> Path:
    return next(ROBOTS.rglob(name))


@needs_robots
@pytest.mark.slow
@pytest.mark.parametrize("path", sorted(ROBOTS.rglob("*.urdf")), ids=lambda path: path.stem)
def test_links_with_collision_geometry_take_part(path: Path, unchecked: None) -> None:
    if path.name in ("ur3.urdf", "alex_psyonic_hands.urdf"):  # not robots
        return
    links = [link for link in ElementTree.parse(path).getroot().findall("link") if link.findall("collision")]
    expected = {link.attrib["name"]: len(link.findall("collision")) for link in links}
    for within in (None, SHARE):
        robot = mechanics.load(path, physical=False, within=within)
        solids = {part.name: part.collision for part in robot.links} | {robot.base: robot.collision}
        assert {name: len(of_link) for name, of_link in solids.items() if of_link} == expected
        unread = {name for name, of_link in solids.items() if any(hasattr(s, "reason") for s in of_link or ())}
        assert all(any(repr(name) in note for note in robot.notes if "<collision>" in note) for name in unread)
        assert within is None or not unread


@needs_robots
@pytest.mark.thorough
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", ["panda", pytest.param("romeo", marks=pytest.mark.slow)])
def test_pairs_of_an_srdf_file_as_pinocchio_has_them(name: str, unchecked: None) -> None:
    import pinocchio as pin

    path, srdf = named(f"{name}.urdf"), named(f"{name}.srdf")
    robot = mechanics.load(path, physical=False)
    model = pin.buildModelFromUrdf(str(path))
    geometry = pin.buildGeomFromUrdf(model, str(path), pin.GeometryType.COLLISION, package_dirs=[str(SHARE)])
    geometry.addAllCollisionPairs()
    pin.removeCollisionPairs(model, geometry, str(srdf))
    frames = [model.frames[part.parentFrame] for part in geometry.geometryObjects]

    def joined(pair: Any) -> bool:
        a, b = frames[pair.first].parentJoint, frames[pair.second].parentJoint
        return bool(model.parents[a] == b or model.parents[b] == a)

    left = [pair for pair in geometry.collisionPairs if not joined(pair)]
    expected = {frozenset((frames[pair.first].name, frames[pair.second].name)) for pair in left}
    balls = {frame.name: Sphere(0.1) for frame in frames}
    pairs = clearances(robot, balls, srdf=srdf)
    assert pairs.keys() <= {"-".join(pair) for pair in itertools.permutations(balls, 2)}
    names = {"-".join(pair): frozenset(pair) for pair in itertools.permutations(balls, 2)}
    assert {names[key] for key in pairs} == expected
    assert len(expected) > 15


@needs_robots
@pytest.mark.thorough
@pytest.mark.filterwarnings("ignore")
def test_distances_of_a_panda_as_coal_has_them(unchecked: None) -> None:
    import coal
    import pinocchio as pin

    path, links = named("panda.urdf"), ("panda_link0", "panda_link4", "panda_hand")
    robot = mechanics.load(path, within=SHARE)
    solids = {link.name: link.collision for link in robot.links} | {robot.base: robot.collision}
    hulls = {name: ConvexPolytope(solids[name][0]) for name in links}
    gaps = tx.lower(clearances(robot, hulls))
    model = pin.buildModelFromUrdf(str(path))
    geometry = pin.buildGeomFromUrdf(model, str(path), pin.GeometryType.COLLISION, package_dirs=[str(SHARE)])
    parts = {model.frames[part.parentFrame].name: part for part in geometry.geometryObjects}
    for name in links:
        parts[name].geometry.buildConvexHull(True, "Qt")
    data, request = model.createData(), coal.DistanceRequest(True)
    request.gjk_tolerance = request.epa_tolerance = 1e-9
    q = np.random.default_rng(0).uniform(model.lowerPositionLimit, model.upperPositionLimit, size=(50, 9))
    every = jax.jit(jax.vmap(lambda q: gaps(0.0, {"q": q})))(q[:, :8])  # the second finger follows the first

    def placed(name: str) -> tuple[Any, Any]:
        T = data.oMi[parts[name].parentJoint] * parts[name].placement
        return parts[name].geometry.convex, coal.Transform3s(T.rotation, T.translation)

    for key, values in every.items():
        first, second = key.split("-")
        for row, value in zip(q, values, strict=True):
            pin.forwardKinematics(model, data, row)
            gap = coal.distance(*placed(first), *placed(second), request, coal.DistanceResult())
            assert abs(float(value) - gap) < 1e-9
    assert len(every) == 3


@needs_robots
@pytest.mark.slow
def test_slopes_of_all_distances_of_a_panda(unchecked: None) -> None:
    """Fingers have parallel faces, of whose nearest features rounding chooses one: the kernel passes its self-test."""
    gaps = tx.lower(tx.Stack(*clearances(mechanics.load(named("panda.urdf"), within=SHARE)).values()))

    def of(q: jax.Array) -> Any:
        return gaps(0.0, {"q": q})

    q = np.array([0.1, 0.4, -0.2, -1.9, 0.3, 2.0, 0.8, 0.02])
    slopes = tx.fast(jax.jacrev(of))(q)
    steps = 1e-6 * np.eye(len(q))
    expected = np.stack([np.asarray(of(q + step) - of(q - step)) / 2e-6 for step in steps], axis=1)
    assert slopes.shape == (42, 8)
    np.testing.assert_allclose(slopes, expected, rtol=0.0, atol=1e-8)


@needs_robots
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(("file", "srdf"), [("g1_29dof_rev_1_0", None), ("talos_reduced", "talos")])
def test_distances_of_humanoids_as_coal_has_them(file: str, srdf: str | None, unchecked: None) -> None:
    """All pairs of links; the meshes as the hulls of `clearances`, on links where Pinocchio has them."""
    import coal
    import pinocchio as pin

    path, rules = named(f"{file}.urdf"), srdf and named(f"{srdf}.srdf")
    robot, model = mechanics.load(path, within=SHARE, physical=False), pin.buildModelFromUrdf(str(path))
    geometry = pin.buildGeomFromUrdf(model, str(path), pin.GeometryType.COLLISION, package_dirs=[str(SHARE)])
    parts: dict[str, list[Any]] = {}
    for part in geometry.geometryObjects:
        parts.setdefault(model.frames[part.parentFrame].name, []).append(part)
    shapes = {link.name: link.collision for link in robot.links} | {robot.base: robot.collision}
    solids = {
        name: [ConvexPolytope(s, most=24) if isinstance(s, tx.view.Mesh) else s for s in shapes[name]] for name in parts
    }
    pairs, data, request = clearances(robot, solids, srdf=rules), model.createData(), coal.DistanceRequest(True)
    request.gjk_tolerance = request.epa_tolerance = 1e-9
    gaps = tx.lower(tx.Stack(*pairs.values()))
    limits = (np.clip(limit, -3.0, 3.0) for limit in (robot.q.min, robot.q.max))
    q = np.random.default_rng(0).uniform(*limits, size=(10, robot.dofs))
    values = np.asarray(jax.jit(jax.vmap(lambda q: gaps(0.0, {"q": q})))(q))

    def placed(solid: Any, part: Any) -> tuple[Any, Any, float]:
        T = data.oMi[part.parentJoint]
        if not isinstance(solid, ConvexPolytope):
            T = T * part.placement
            return part.geometry, coal.Transform3s(T.rotation, T.translation), 0.0
        T, points = T * model.frames[part.parentFrame].placement, coal.StdVec_Vec3s()
        for corner in solid.corners:
            points.append(corner)
        return coal.Convex.convexHull(points, True, "Qt"), coal.Transform3s(T.rotation, T.translation), solid.radius

    def gap(a: tuple[Any, Any, float], b: tuple[Any, Any, float]) -> float:
        return float(coal.distance(*a[:2], *b[:2], request, coal.DistanceResult())) - a[2] - b[2]

    names = {"-".join(pair): pair for pair in itertools.permutations(parts, 2)}
    for positions, row in zip(q, values, strict=True):
        at = pin.neutral(model)
        for name, value in zip(robot.joints, positions, strict=True):
            at[model.joints[model.getJointId(name)].idx_q] = value
        pin.forwardKinematics(model, data, at)
        bodies = {name: [placed(*pair) for pair in zip(solids[name], parts[name], strict=True)] for name in parts}
        for key, value in zip(pairs, row, strict=True):
            first, second = names[key]
            expected = min(gap(a, b) for a in bodies[first] for b in bodies[second])
            # Coal's depth of a cylinder may be larger than that of the shortest translation.
            depth = expected < 0.0 and any(isinstance(s, tx.view.Cylinder) for s in solids[first] + solids[second])
            assert value - expected > -1e-6 if depth else abs(value - expected) < 1e-6, (key, value, expected)
    assert len(pairs) == {"g1_29dof_rev_1_0": 402, "talos_reduced": 883}[file]
