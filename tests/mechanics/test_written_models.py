"""Mechanisms as URDF and MJCF: what is read back has the same dynamics, frames, limits, motors, closures and shapes."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mechanics_oracles import Cloud, body_of, pose
from scipy.spatial.transform import Rotation
from test_editing import four_bar, inputs, near, panda, random_state

import twistax as tx
from evaluated import evaluated
from twistax import mechanics, view
from twistax.errors import ModelError
from twistax.mechanics import Drive, Link, Mechanism, Mimic, SpatialInertia, joints, loops

EXAMPLES, OWN = Path(__file__).parents[2] / "examples", Path(__file__).parent / "models"
AXIS = np.array([0.6, 0.0, -0.8])


def dynamics(mechanism: Mechanism) -> dict[str, tx.Expr]:
    aba = mechanics.forward_dynamics(mechanism, tau=np.linspace(-1.0, 1.0, mechanism.dofs))
    return {"M": mechanics.mass_matrix(mechanism), "b": mechanics.bias_forces(mechanism), "aba": aba}


def read_back(mechanism: Mechanism, folder: Path, how: str, **options: Any) -> Mechanism:
    path = folder / f"model.{how}"
    path.write_text(getattr(mechanism, f"to_{how}")(**options))
    return mechanics.load(path, quarter_turns=0.0, physical=False)


def same(before: Mechanism, after: Mechanism, frames: bool = True) -> None:
    """The dynamics to rounding, and all that is said of frames, limits and motors."""
    assert set(after.joints) == set(before.joints)
    assert set(after.driven) == set(before.driven)
    positions, rates = random_state(before)
    values = [evaluated(dynamics(m), inputs(m, positions, rates)) for m in (before, after)]
    order = [[i for name in before.joints for i in m.segment_of(name).freedoms] for m in (before, after)]
    for name in ("b", "aba"):
        near(values[1][name][order[1]], values[0][name][order[0]])
    near(values[1]["M"][np.ix_(order[1], order[1])], values[0]["M"][np.ix_(order[0], order[0])])
    for joint in before.joints:
        mine, theirs = (m.segment_of(joint).link.drive for m in (before, after))
        assert (theirs.lower, theirs.upper) == (mine.lower, mine.upper)
    if frames:
        assert before.frames.keys() <= after.frames.keys()
        poses = {name: before.pose(name) for name in before.frames}
        state = evaluated(poses, inputs(before, positions, rates))
        again = evaluated({name: after.pose(name) for name in poses}, inputs(after, positions, rates))
        for name in poses:
            near(again[name], state[name])


def tree(*, spherical: bool = True, **drives: Drive) -> Mechanism:
    """A floating body with a hinge, a slide with a follower, a ball, a fixed tool, and shapes."""
    rng = np.random.default_rng(5)

    def link(joint: joints.Joint, parent: str | None, mount: Any = None, **more: Any) -> Link:
        body = body_of(Cloud.random(rng, 5))
        mount = pose(rng) if mount is None else mount
        return Link(joint, body, mount, parent=parent, drive=drives.get(joint.name, Drive()), **more)

    shapes = [view.Box((0.1, 0.2, 0.3), at=pose(rng)), view.Sphere(0.1), view.Capsule(0.1, 0.4, color=(1, 2, 3))]
    links = [
        link(joints.Free("root"), None, np.eye(4), name="trunk", shapes=shapes),
        link(joints.Revolute("hinge", AXIS), "trunk", name="thigh"),
        link(joints.Prismatic("slide", -AXIS), "thigh"),
        link(joints.Prismatic("other", AXIS), "thigh", mimic=Mimic("slide", ratio=-1.7, offset=0.4)),
        link(joints.Fixed("tool"), "slide", shapes=[view.Cylinder(0.1, 0.3, opacity=0.5)]),
        Link(joints.Fixed("eye"), None, pose(rng), parent="tool"),
    ]
    return Mechanism([*links, link(joints.Spherical("ball"), "trunk")] if spherical else links)


@pytest.mark.parametrize("how", ["urdf", "mjcf"])
def test_a_tree_with_every_kind_of_joint_of_both_formats(how: str, tmp_path: Path) -> None:
    before = tree(
        hinge=Drive(damping=0.3, friction=0.2, effort=3.0, lower=-1.0, upper=2.0), slide=Drive(effort=2.0, lower=0.1)
    )
    after = read_back(before, tmp_path, how)
    same(before, after)
    drive = after.segment_of("hinge").link.drive
    assert (drive.damping, drive.friction, drive.efforts) == (0.3, 0.2, (-3.0, 3.0))
    assert after.segment_of("other").link.mimic == Mimic("slide", ratio=-1.7, offset=0.4)
    for link in before.links:
        shapes = after.link(link.name).shapes
        assert [type(shape) for shape in shapes] == [type(shape) for shape in link.shapes]
        for mine, theirs in zip(link.shapes, shapes, strict=True):
            assert (theirs.color, theirs.opacity) == (mine.color, mine.opacity)
            near(theirs.corners(), mine.corners())


@pytest.mark.parametrize("how", ["urdf", "mjcf"])
def test_collision_geometry_is_read_back(how: str, tmp_path: Path) -> None:
    pytest.importorskip("trimesh")
    rng = np.random.default_rng(1)
    corners, faces = view.Box((0.2, 0.3, 0.4)).mesh()
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces]
    (tmp_path / "hand.obj").write_text("\n".join(lines))
    both = view.Capsule(0.1, 0.4, at=pose(rng))
    solids = [view.Mesh(tmp_path / "hand.obj", at=pose(rng), scale=0.5), view.Cylinder(0.1, 0.2, at=pose(rng))]
    body, options = body_of(Cloud.random(rng, 5)), {"shapes": [view.Sphere(0.3)]}

    def link(name: str, parent: str | None, **more: Any) -> Link:
        return Link(joints.Revolute(name, AXIS), body, pose(rng), parent=parent, **more)

    links = [link("a", None, **options, collision=()), link("b", "a", **options, collision=solids)]
    links += [link("c", "b", shapes=[both], collision=[both]), link("d", "c", **options)]
    before = Mechanism(links, base="world", collision=[view.Box((1.0, 1.0, 0.1))])
    after = read_back(before, tmp_path, how)
    assert list(mechanics.clearances(after)) == list(mechanics.clearances(before)) != []
    for mine, theirs in zip([before, *links], [after, *(after.link(part.name) for part in links)], strict=True):
        expected = mine.shapes if mine.collision is None else mine.collision
        assert [type(solid) for solid in theirs.collision] == [type(solid) for solid in expected]
        for one, other in zip(theirs.collision, expected, strict=True):
            near(one.corners(), other.corners())
    for name in "abcd":
        assert [type(s) for s in after.link(name).shapes] == [type(s) for s in before.link(name).shapes]
    flat = before.replace(links=[link("a", None, collision=[view.Mesh((corners, faces))])])
    with pytest.raises(ModelError, match="collision: of 'a'"):
        getattr(flat, f"to_{how}")()


@pytest.mark.parametrize("how", ["urdf", "mjcf"])
def test_mounts_at_all_angles(how: str, tmp_path: Path) -> None:
    rng, quarter = np.random.default_rng(0), np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    body = body_of(Cloud.random(rng, 5))
    mounts = [pose(rng) for _ in range(8)]
    for T, pitch in zip(mounts, (quarter, quarter.T), strict=False):  # where roll and yaw are one angle
        T[:3, :3] = Rotation.from_euler("z", 0.7).as_matrix() @ pitch
    links = [Link(joints.Revolute(f"hinge{i}", AXIS), body, T) for i, T in enumerate(mounts)]
    after = read_back(Mechanism(links), tmp_path, how)
    for link in links:
        near(after.link(link.name).mount.value, link.mount.value, 1e-14)
        near(after.link(link.name).body.inertia.value, body.inertia.value, 1e-14)


def test_urdf_read_by_pinocchio(tmp_path: Path) -> None:
    pin = pytest.importorskip("pinocchio", reason="pinocchio is not installed (extra twistax[peers])")
    arm = panda().lock({"joint3": 0.4}).rerooted("link4").with_inertia({"link0": panda().link("link1").body})
    arm = arm.replace(gravity=(0.0, 0.0, -9.81))
    path = tmp_path / "arm.urdf"
    path.write_text(arm.to_urdf())
    model = pin.buildModelFromUrdf(str(path))
    rng, data = np.random.default_rng(0), model.createData()
    at = [model.joints[model.getJointId(name)].idx_q for name in arm.joints]
    q, qd = np.zeros(6), np.zeros(6)
    q[at], qd[at] = ours = rng.normal(size=(2, 6))
    bias = evaluated({"b": mechanics.bias_forces(arm)}, {"q": ours[0], "qd": ours[1]})["b"]
    near(bias, pin.rnea(model, data, q, qd, np.zeros(6))[at])


def test_mjcf_simulated_by_mujoco(tmp_path: Path) -> None:
    mujoco = pytest.importorskip("mujoco", reason="mujoco is not installed (extra twistax[models])")
    spring = Drive(
        armature=0.2, stiffness=5.0, rest=0.3, damping=0.1, gear=2.0, effort=(-1.0, 3.0), lower=-9.0, upper=9.0
    )
    before = tree(spherical=False, hinge=spring).lock({"root": np.eye(4)}).replace(driven=["hinge"])
    model = mujoco.MjModel.from_xml_string(before.to_mjcf())
    data = mujoco.MjData(model)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_EQUALITY)
    data.qpos[:], data.qvel[:], data.ctrl[:] = [0.2, -0.3, 1.7 * 0.3 + 0.4], [0.5, 0.6, -1.7 * 0.6], [0.7]
    mujoco.mj_forward(model, data)
    M = np.zeros((3, 3))
    mujoco.mj_fullM(model, data, M)
    G = np.array([[1.0, 0.0], [0.0, 1.0], [0.0, -1.7]])
    forces = G.T @ (data.qfrc_actuator + data.qfrc_passive - data.qfrc_bias)
    system = before.system(outputs=lambda qdd, tau: {"qdd": qdd})
    qdd = tx.compile(system).outputs(0.0, {"q": data.qpos[:2], "qd": data.qvel[:2]}, {"tau": data.ctrl})["qdd"]
    near(qdd, np.linalg.solve(G.T @ M @ G, forces), 1e-11)
    assert read_back(before, tmp_path, "mjcf").segment_of("hinge").link.drive == spring


def test_a_fixed_link_with_an_inertia_and_no_mass(tmp_path: Path) -> None:
    """Files contain such links, the Panda's of frax for example; MuJoCo accepts them where they are fixed."""
    inertia = "<inertial><mass value='{}'/><inertia ixx='.1' iyy='.1' izz='.1' ixy='0' ixz='0' iyz='0'/></inertial>"
    (tmp_path / "arm.urdf").write_text(f"""<robot name="arm"><link name="base"/>
        <link name="rod">{inertia.format(1)}</link><link name="flange">{inertia.format(0)}</link>
        <joint name="hinge" type="continuous"><parent link="base"/><child link="rod"/><axis xyz="0 0 1"/></joint>
        <joint name="weld" type="fixed"><parent link="rod"/><child link="flange"/><origin xyz="1 0 0"/></joint></robot>
    """)
    before = mechanics.load(tmp_path / "arm.urdf")
    same(before, read_back(before, tmp_path, "mjcf"))
    near(evaluated({"M": mechanics.mass_matrix(before)}, {"q": np.zeros(1)})["M"], [[0.2]])


def test_closures_go_into_mjcf(tmp_path: Path) -> None:
    linkage = four_bar().replace(gravity=(0.0, 1.0, -3.0))
    with pytest.raises(ModelError, match="closures: of 'closure'"):
        linkage.to_mjcf()
    pinned = linkage.replace(loops=[loops.PointLoop("ends", "tip", "pin"), loops.PoseLoop("weld", "crank", "rocker")])
    after = read_back(pinned, tmp_path, "mjcf")
    assert [type(loop) for loop in after.loops] == [loops.PointLoop, loops.PoseLoop]
    q = {"q": np.array([0.3, -0.4, 0.9])}
    for name in ("ends", "weld"):
        near(*(evaluated({"gap": mechanics.loop_gap(m, name)}, q)["gap"] for m in (after, pinned)))


def test_joints_in_series_are_one_body_of_mjcf(tmp_path: Path) -> None:
    rng, (one, two) = np.random.default_rng(0), joints.universal("cardan", (0.0, 1.0, 0.0), AXIS)

    def cardan(mount: np.ndarray) -> Mechanism:
        first = Link(one, None, pose(rng))
        return Mechanism([first, Link(two, body_of(Cloud.random(rng, 5)), mount, parent="cardan_1")])

    shifted = cardan(tx.pose(position=[0.1, -0.2, 0.3]))
    same(shifted, read_back(shifted, tmp_path, "mjcf"))
    turned = cardan(pose(rng))
    with pytest.raises(ModelError, match="frames: of 'cardan_1'"):
        turned.to_mjcf()
    same(turned, read_back(turned, tmp_path, "mjcf", leave_out=["frames"]), frames=False)


def test_parameters_are_written_with_their_values(tmp_path: Path) -> None:
    options = {"parameters": True, "quarter_turns": 0.0}
    chosen, plain = (mechanics.load(EXAMPLES / "arm.urdf", **more) for more in (options, {"quarter_turns": 0.0}))
    same(plain, read_back(chosen, tmp_path, "urdf"))
    body = SpatialInertia(mass=tx.Parameter("m"), inertia=np.eye(3))
    unknown = Mechanism([Link(joints.Revolute("a", AXIS), body, np.eye(4))])
    with pytest.raises(ModelError, match=r"the mass of link 'a'.*has no value"):
        unknown.to_urdf()


def test_what_urdf_has_no_words_for() -> None:
    sprung = Drive(armature=0.1, stiffness=2.0, effort=(0.0, 1.0))
    arm = panda().replace(drives={"joint2": sprung}, gravity=(0.0, 0.0, 0.0))
    with pytest.raises(ModelError) as raised:
        arm.to_urdf()
    for line in (
        "armature: of 'joint2'",
        "effort: of 'joint2'",
        "gravity: of 'the mechanism'",
        "stiffness: of 'joint2'",
    ):
        assert line in str(raised.value)
    assert "joint2" in arm.to_urdf(leave_out=["armature", "effort", "gravity", "stiffness"])
    with pytest.raises(ModelError, match="cannot leave out 'weight'"):
        arm.to_urdf(leave_out=["weight"])
    with pytest.raises(ModelError, match=r"speed: of 'joint1', 'joint2', 'joint3'"):
        panda().to_mjcf()
    rod = Mechanism([Link(joints.Cylindrical("rod", AXIS), body_of(Cloud.random(np.random.default_rng(0))), np.eye(4))])
    for write in (rod.to_urdf, rod.to_mjcf):
        with pytest.raises(ModelError, match=r"no joint such as Cylindrical\('rod'\)"):
            write()


def test_what_mujoco_refuses_is_said_before() -> None:
    hanging = panda().with_inertia({"link7": None})
    with pytest.raises(ModelError, match="link 'link7' moves, but neither it"):
        hanging.to_mjcf(leave_out=["speed"])
    point = panda().with_inertia({"link7": SpatialInertia(mass=1.0, inertia=np.zeros((3, 3)))})
    with pytest.raises(ModelError, match=r"positive principal moments[\s\S]*with_inertia\(\{'link7'"):
        point.to_mjcf(leave_out=["speed"])
    floating = Mechanism([Link(joints.Free("root"), panda().link("link7").body, tx.pose(position=[1.0, 0.0, 0.0]))])
    with pytest.raises(ModelError, match="free joint 'root'"):
        floating.to_mjcf()
