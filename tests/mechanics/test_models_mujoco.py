"""Mechanisms from MJCF against MuJoCo, where that is installed; and every model that comes with packages at hand."""

import importlib.util
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from mujoco_models import mujoco_model

import twistax as tx
from evaluated import evaluated
from twistax import mechanics
from twistax.expr import leaves_of
from twistax.mechanics import Mechanism

mujoco = pytest.importorskip("mujoco", reason="mujoco is not installed (extra twistax[models])")

OWN = Path(__file__).parent / "models"
FREE, BALL = int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_BALL)


def at_hand() -> list[Path]:
    """The models in installed packages."""
    found = sorted((Path(mujoco.__file__).parent / "testdata").glob("model.xml"))
    frax = importlib.util.find_spec("frax")
    if frax is not None and frax.origin is not None:
        found += sorted(Path(frax.origin).parent.glob("assets/*/*.xml"))
    return found


class Pair:
    """A mechanism, and MuJoCo's model of the same file without what the former's notes list."""

    def __init__(self, path: Path) -> None:
        # Dry friction is smooth here and a constraint there: it is left out on both sides.
        plain = mechanics.load(path)
        rubbing = [s.link.joint.name for s in plain.segments if s.link.drive.friction]
        self.friction = {f"{name}_friction": np.zeros(()) for name in rubbing}
        loaded = mechanics.load(path, quarter_turns=0.0, parameters=list(self.friction))
        # So are equalities, which have a test of their own.
        self.ours = Mechanism(loaded.links, loaded.gravity, base=next(iter(loaded.frames)), driven=loaded.driven)
        self.model = model = mujoco_model(path)
        off = mujoco.mjtDisableBit
        model.opt.disableflags |= int(off.mjDSBL_CONSTRAINT)
        model.opt.density = model.opt.viscosity = 0.0
        model.body_gravcomp[:] = 0.0
        self.data = mujoco.MjData(model)
        self.used = [
            (a, int(model.actuator_trnid[a, 0]))
            for a in range(model.nu)
            if model.joint(model.actuator_trnid[a, 0]).name in self.ours.driven and model.actuator_dyntype[a] == 0
        ]
        for a in {*range(model.nu)} - {a for a, _ in self.used}:
            model.actuator_gainprm[a] = model.actuator_biasprm[a] = 0.0

    def joints(self) -> list[tuple[int, str, int, int, Any]]:
        """Number, name, and the places in MuJoCo's positions and velocities, with our segment."""
        model = self.model
        names = [model.joint(j).name or f"joint_{j}" for j in range(model.njnt)]
        return [
            (int(model.jnt_type[j]), names[j], int(model.jnt_qposadr[j]), int(model.jnt_dofadr[j]),
             self.ours.segment_of(names[j]))
            for j in range(model.njnt)
        ]  # fmt: skip

    def positions(self, rng: np.random.Generator) -> tuple[dict[str, np.ndarray], np.ndarray]:
        theirs, ours = np.array(self.model.qpos0), {}
        width = max((s.coordinates.stop for s in self.ours.segments if s.coordinates is not None), default=0)
        vector = np.zeros(width)
        for kind, name, at, _, segment in self.joints():
            if kind in (FREE, BALL):
                R, quaternion = np.zeros(9), rng.normal(size=4)
                quaternion /= np.linalg.norm(quaternion)
                mujoco.mju_quat2Mat(R, quaternion)
                T = np.eye(4)
                T[:3, :3] = R.reshape(3, 3)
                if kind == FREE:
                    T[:3, 3] = theirs[at : at + 3] = rng.normal(size=3)
                theirs[at + (3 if kind == FREE else 0) :][:4] = quaternion
                ours[f"{name}_position"] = T if kind == FREE else T[:3, :3]
            else:
                theirs[at] = vector[segment.coordinates] = rng.uniform(-1.5, 1.5)
        return ({"q": vector} if width else {}) | ours, theirs

    def velocities(self, q: dict[str, np.ndarray], qd: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """G (nv, n), theirs = G ours, and its rate times qd: theirs have the free bodies' v in world axes."""
        G, drift = np.zeros((self.model.nv, self.ours.dofs)), np.zeros(self.model.nv)
        for kind, name, _, at, segment in self.joints():
            for k, i in enumerate(segment.freedoms):
                G[at + k, i] = 1.0
            if kind == FREE:
                R, V = q[f"{name}_position"][:3, :3], qd[list(segment.freedoms)]
                G[np.ix_(range(at, at + 3), segment.freedoms[:3])] = R
                drift[at : at + 3] = R @ np.cross(V[3:], V[:3])
        return G, drift


def near(found: np.ndarray, expected: np.ndarray, bound: float = 1e-10) -> None:
    scale = max(float(np.max(np.abs(expected), initial=0.0)), 1e-3)
    assert np.max(np.abs(found - expected), initial=0.0) <= bound * scale


def compared(path: Path, count: int) -> None:
    pair = Pair(path)
    robot, model, data = pair.ours, pair.model, pair.data
    wanted: dict[str, Any] = {
        "mass": mechanics.mass_matrix(robot),
        "bias": mechanics.bias_forces(robot),
        "kinetic": mechanics.kinetic_energy(robot),
    }
    bodies = [model.body(i).name or f"body_{i}" for i in range(1, model.nbody)]
    sites = [model.site(i).name for i in range(model.nsite) if model.site(i).name]
    for name in bodies:
        wanted[f"pose of {name}"] = robot.pose(name)
    for name in {bodies[-1], bodies[len(bodies) // 2], bodies[0]}:
        wanted[f"J of {name}"] = mechanics.frame_jacobian(robot, name, axes=mechanics.ALIGNED)
    rng = np.random.default_rng(0)
    dynamics = tx.compile(robot.system(), backend=tx.JAX())
    kinematics = jax.jit(tx.lower(wanted))
    used = {leaf.name for leaf in leaves_of(*wanted.values())}
    for _ in range(count):
        q, theirs = pair.positions(rng)
        qd = rng.normal(size=robot.dofs)
        G, drift = pair.velocities(q, qd)
        data.qpos, data.qvel = theirs, G @ qd
        u = rng.uniform(-0.05, 0.3, size=len(robot.driven))
        data.ctrl = 0.0
        for a, j in pair.used:
            data.ctrl[a] = u[robot.driven.index(model.joint(j).name)]
        mujoco.mj_forward(model, data)
        state = {**q, "qd": qd}
        found = kinematics(0.0, {name: value for name, value in state.items() if name in used})
        M = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, M)
        near(found["mass"], G.T @ M @ G)
        near(found["bias"], G.T @ (np.array(data.qfrc_bias) + M @ drift))
        near(found["kinetic"], 0.5 * data.qvel @ M @ data.qvel)
        for name in bodies:
            at = bodies.index(name) + 1
            near(found[f"pose of {name}"][:3, 3], data.xpos[at])
            near(found[f"pose of {name}"][:3, :3], data.xmat[at].reshape(3, 3))
            if f"J of {name}" in found:
                J = np.zeros((6, model.nv))
                mujoco.mj_jacBody(model, data, J[:3], J[3:], at)
                near(found[f"J of {name}"], J @ G)
        assert set(sites) <= set(robot.frames)
        rate = np.asarray(dynamics(0.0, state, {"tau": u} if robot.driven else {}, pair.friction)["qd"])
        near(G @ rate + drift, data.qacc)


def test_a_model_with_every_kind_of_joint(unchecked: None) -> None:
    compared(OWN / "machine.xml", count=3)


@pytest.mark.slow
@pytest.mark.parametrize("path", at_hand(), ids=lambda path: path.stem)
def test_every_model_at_hand(path: Path, unchecked: None) -> None:
    compared(path, count=20)


def test_what_is_not_used_is_said() -> None:
    machine = mechanics.load(OWN / "machine.xml")
    assert machine.driven == ("yaw", "reach", "shaft", "along", "across")
    assert machine.notes == (
        "actuators of tendons, sites and bodies: 1",
        "geoms of meshes and height fields: 1",
        "sensors: 1",
        "geoms that are not drawn, meshes and planes: 1",
        "an actuator of joint 'turn', whose force is not a linear function of control and motion",
        "contacts of geoms: 7",
        "dry friction of joints is smooth here, see Drive",
    )
    tau = machine.motors(machine.driven)
    np.testing.assert_array_equal(tau.min, [-1.0, -0.1, -np.inf, -2.0, -np.inf])
    np.testing.assert_array_equal(tau.max, [1.0, 0.4, np.inf, 4.0, np.inf])
    at = machine.segment_of("pitch").coordinates
    np.testing.assert_allclose([machine.q["q"].min[at], machine.q["q"].max[at]], np.radians([[-80.0], [70.0]]))


ROD = '<inertial pos="0.1 0 0.2" mass="1" diaginertia="0.2 0.3 0.4"/>'


@pytest.mark.parametrize(
    "option",
    [
        '<flag spring="disable" damper="disable"/>',
        '<flag actuation="disable"/>',
        '<option actuatorgroupdisable="2"/>',
    ],
)
def test_what_a_file_switches_off_does_not_act(option: str, tmp_path: Path) -> None:
    path = tmp_path / "model.xml"
    option = option if option.startswith("<option") else f"<option>{option}</option>"
    path.write_text(
        f"<mujoco>{option}<worldbody><body>{ROD}<joint name='h' axis='0 1 1' stiffness='20' damping='2'/>"
        "</body></worldbody><actuator><position joint='h' kp='30' kv='3' group='2'/></actuator></mujoco>"
    )
    robot, model = mechanics.load(path), mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    data.qpos[0], data.qvel[0], data.ctrl[0] = 0.3, 1.0, 0.1
    mujoco.mj_forward(model, data)
    control = {"tau": data.ctrl} if robot.driven else {}
    found = evaluated(robot.system().rates["qd"], {"q": data.qpos, "qd": data.qvel}, control)
    np.testing.assert_allclose(found, data.qacc, rtol=1e-12)


def test_parameters_of_a_joint_are_its_own_beside_a_servo(tmp_path: Path) -> None:
    """Its spring and damper, with the values of the file; those of the servo stay."""
    path = tmp_path / "model.xml"
    text = (
        "<mujoco><worldbody><body>{}<joint name='h' axis='0 1 1' stiffness='{}' springref='40' damping='{}'/>"
        "</body></worldbody><actuator><position joint='h' kp='30' kv='3'/></actuator></mujoco>"
    )
    path.write_text(text.format(ROD, 20, 2))
    rates = mechanics.load(path, parameters=["h_stiffness", "h_damping"]).system().rates["qd"]
    model = mujoco.MjModel.from_xml_string(text.format(ROD, 50, 5))
    data = mujoco.MjData(model)
    data.qpos[0], data.qvel[0], data.ctrl[0] = 0.3, 1.0, 0.1
    mujoco.mj_forward(model, data)
    state, other = {"q": data.qpos, "qd": data.qvel}, {"h_stiffness": 50.0, "h_damping": 5.0}
    np.testing.assert_allclose(evaluated(rates, state, {"tau": data.ctrl}, other), data.qacc, rtol=1e-12)


LINKAGE = """<mujoco>
  <option gravity="0.5 1 -9"/>
  <worldbody>
    <site name="post" pos="0.9 0 0.1"/>
    <body name="crank"><joint name="a" axis="0 1 0" ref="10"/>{rod}
      <body name="coupler" pos="0.4 0 0.1"><joint name="b" axis="0 1 0.1" pos="0 0 0.05"/>{rod}
        <site name="pin" pos="0.5 0.1 -0.1" euler="10 20 30"/>
      </body>
    </body>
    <body name="rocker" pos="1 0 0" euler="0 20 0"><joint name="c" type="ball"/>{rod}
      <body name="wheel" pos="0 0 0.2"><joint name="d" axis="1 0 0"/>{rod}</body>
      <body name="gear" pos="0 0.1 0.2"><joint name="e" axis="0 0 1" ref="-20"/>{rod}</body>
    </body>
    <body name="raft" pos="0 1 0"><freejoint name="afloat"/>{rod}</body>
  </worldbody>
  <equality>
    <connect name="knuckle" body1="coupler" body2="rocker" anchor="0.5 0.1 -0.1"/>
    <weld name="tie" body1="raft" body2="gear" anchor="0.2 0.1 0"/>
    <connect name="post" site1="pin" site2="post" active="{active}"/>
    <joint name="teeth" joint1="d" joint2="e" polycoef="0.1 -2 0 0 0"/>
    <joint name="cam" joint1="a" joint2="b" polycoef="0 1 0.5 0 0"/>
  </equality>
  <actuator><motor joint="{driven}"/></actuator>
</mujoco>"""


@pytest.mark.parametrize("driven", ["d", "e"])
def test_equalities_are_loops_and_followers(driven: str, tmp_path: Path) -> None:
    """At rest the accelerations are those that MuJoCo's own rows of the equalities give if they hold exactly."""
    path = tmp_path / "model.xml"
    path.write_text(LINKAGE.format(rod=ROD, active="false", driven=driven))
    robot, model = mechanics.load(path), mujoco_model(path)
    assert [repr(loop) for loop in robot.loops] == [
        "PointLoop('knuckle', 'knuckle on coupler', 'knuckle on rocker')",
        "PoseLoop('tie', 'tie on raft', 'tie on gear')",
    ]
    assert robot.notes == (
        "equality 'post', which the file switches off",
        "equality 'cam', which is not a linear relation of two joints",
        "equalities are exact here: solref and solimp are not used",
    )
    data = mujoco.MjData(model)
    lead, follow = ("e", "d") if driven == "e" else ("d", "e")
    data.joint("e").qpos = -np.radians(20) + 0.3
    data.joint("d").qpos = 0.1 - 2.0 * 0.3
    data.ctrl = 1.7
    mujoco.mj_forward(model, data)
    # Where the loops are closed: the weld's by the place of the raft.
    T = np.eye(4)
    tie = lower_pose(robot, "tie on gear", {"q": place_of(robot, data, follow), "c_position": np.eye(3)})
    T[:] = tie @ np.linalg.inv(np.asarray(robot.frame("tie on raft").T.value))
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(T[:3, :3]).reshape(-1))
    data.joint("afloat").qpos = [*T[:3, 3], *quaternion]
    mujoco.mj_forward(model, data)
    x = {"q": place_of(robot, data, follow), "c_position": np.eye(3), "afloat_position": T, "qd": np.zeros(robot.dofs)}
    kept = np.asarray(data.efc_type) == int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)
    cam = np.asarray(data.efc_id) == 4
    J = np.asarray(data.efc_J).reshape(-1, model.nv)[kept & ~cam]
    assert J.shape[0] == 3 + 6 + 1
    np.testing.assert_allclose(np.asarray(data.efc_pos)[kept & ~cam], 0.0, atol=1e-12)
    M = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, M)
    held = np.block([[M, J.T], [J, np.zeros((len(J), len(J)))]])
    force = data.qfrc_actuator + data.qfrc_passive - data.qfrc_bias
    expected = np.linalg.solve(held, [*force, *np.zeros(len(J))])[: model.nv]
    found = np.asarray(evaluated(robot.system().rates["qd"], x, {"tau": data.ctrl}))
    for name in ("a", "b", "c", lead, "afloat"):
        at = model.joint(name).dofadr[0]
        own = list(robot.segment_of(name).freedoms)
        qacc = expected[at : at + len(own)]
        if name == "afloat":
            qacc = np.concatenate([T[:3, :3].T @ qacc[:3], qacc[3:]])
        np.testing.assert_allclose(found[own], qacc, rtol=1e-7, atol=1e-7)


def place_of(robot: Mechanism, data: Any, follower: str) -> np.ndarray:
    """MuJoCo's angles as ours, those of followers left out."""
    q = np.zeros(3)
    for name in "abde".replace(follower, ""):
        q[robot.segment_of(name).coordinates] = data.joint(name).qpos
    return q


def lower_pose(robot: Mechanism, frame: str, x: dict[str, np.ndarray]) -> np.ndarray:
    return np.asarray(evaluated(robot.pose(frame), x))


def test_equalities_that_say_nothing_are_noted(tmp_path: Path) -> None:
    path = tmp_path / "model.xml"
    path.write_text(
        f"<mujoco><worldbody><body name='a'><joint name='h'/>{ROD}<body name='b'>{ROD}</body></body></worldbody>"
        "<equality><weld name='w' body1='a' body2='b'/><joint name='j' joint1='h'/></equality></mujoco>"
    )
    assert mechanics.load(path).notes == (
        "equality 'w', between bodies that do not move against each other",
        "equality 'j', which is not a linear relation of two joints",
    )


def test_sizes_take_no_memory(tmp_path: Path) -> None:
    path = tmp_path / "model.xml"
    path.write_text(f"<mujoco><size memory='9000P'/><worldbody><body>{ROD}<joint/></body></worldbody></mujoco>")
    assert mechanics.load(path).dofs == 1


def test_the_armature_of_a_free_joint(tmp_path: Path) -> None:
    """Its momentum is along world axes there and in the body's here: turning it takes a force."""
    path = tmp_path / "model.xml"
    path.write_text(f"<mujoco><worldbody><body>{ROD}<joint type='free' armature='1'/></body></worldbody></mujoco>")
    assert mechanics.load(path).notes == ()
    compared(path, 2)


def test_numbers_of_a_file_become_parameters() -> None:
    """Other values, given to one expression, are those of a file that has them."""
    machine = mechanics.load(OWN / "machine.xml", parameters=["load_mass", "crane_origin", "sway_axis"])
    plain = mechanics.load(OWN / "machine.xml")
    x = tx.State("x", (machine.dofs,))
    rng = np.random.default_rng(1)
    q, _ = Pair(OWN / "machine.xml").positions(rng)
    state = {**q, "qd": rng.normal(size=machine.dofs), "x": rng.normal(size=machine.dofs)}
    ours = tx.lower(mechanics.inverse_dynamics(machine, qdd=x))
    np.testing.assert_allclose(ours(0.0, state), evaluated(mechanics.inverse_dynamics(plain, qdd=x), state))
    assert np.abs(np.asarray(ours(0.0, state, {}, {"load_mass": 2.5}) - ours(0.0, state))).max() > 1e-3


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('<include file="../b.xml"/>', r"line 2, <include>: the file '../b.xml' lies outside"),
        ('<include file="/etc/passwd"/>', r"line 2, <include>: the file '/etc/passwd' lies outside"),
        ('<include file="model.xml"/>', r"line 2, <include>: 'model.xml' is included twice, or includes itself"),
        ('<include file="none.xml"/>', r"cannot read '.*none.xml'"),
        ('<extension><plugin plugin="p"/></extension>', "line 2, <extension>: plugins run code of their own"),
        ('<asset><model name="m" file="m.xml"/></asset>', "line 2, <model name='m'>: models inside of models"),
        (
            "<worldbody>\n<body>\n<joint foo='1'/></body></worldbody>",
            "line 4, <joint>: .*unrecognized attribute: 'foo'",
        ),
        ("<worldbody>\n<body name='x'>\n<joint/></body></worldbody>", "line 3, <body name='x'>: mass and inertia"),
        ("<worldbody>\n<geom size='1'/></worldbody>", "line 1, <mujoco>: there is no <body>"),
        (
            '<asset>\n<mesh name="m" file="../m.stl"/></asset><worldbody><body><joint/>'
            '<geom type="mesh" mesh="m"/></body></worldbody>',
            "line 3, <mesh name='m'>: the file '../m.stl' lies outside",
        ),
        (
            '<asset>\n<mesh name="m" file="m.stl"/></asset><worldbody><body><joint/>'
            '<geom type="mesh" mesh="m"/></body></worldbody>',
            "line 3, <mesh name='m'>: Error opening file",
        ),
        ("<!DOCTYPE mujoco>", "this is not XML|document type"),
        (
            "<worldbody><body><joint/>\n<inertial pos='nan 0 0' mass='1' diaginertia='1 1 1'/></body></worldbody>",
            "line 3, <inertial>: expected finite numbers in pos, got 'nan 0 0'",
        ),
        (
            f"<worldbody>{'<body>' * 2000}{'</body>' * 2000}</worldbody>",
            "<body>: elements are nested more than 200 deep",
        ),
    ],
)
def test_broken_files_say_where(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "inner" / "model.xml"
    path.parent.mkdir()
    path.write_text(f"<mujoco>\n{text}</mujoco>")
    with pytest.raises(tx.ModelError, match=message):
        mechanics.load(path)
