"""Edits of mechanisms: the dynamics of what comes out against Pinocchio's edits, and against the mechanism before."""

import pickle
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from joints_of_every_kind import Tree, free_tree, mimicking_tree
from mechanics_oracles import Cloud, body_of, pose

import twistax as tx
from evaluated import evaluated
from twistax import mechanics
from twistax.errors import ModelError, ShapeError
from twistax.mechanics import Drive, Link, Mechanism, SpatialInertia, joints, loops

EXAMPLES = Path(__file__).parents[2] / "examples"
Z = (0.0, 0.0, 1.0)


def panda() -> Mechanism:
    return mechanics.load(EXAMPLES / "panda.urdf", quarter_turns=0.0)


def inputs(mechanism: Mechanism, positions: dict[str, Any], rates: dict[str, Any]) -> dict[str, Any]:
    """The states of a mechanism from positions and velocities by joint."""
    values: dict[str, Any] = {"qd": np.zeros(mechanism.dofs)}
    width = max((s.coordinates.stop for s in mechanism.segments if s.coordinates is not None), default=0)
    if width:
        values["q"] = np.zeros(width)
    for segment in mechanism.segments:
        name = segment.link.joint.name
        if segment.link.mimic is None and segment.freedoms:
            values["qd"][list(segment.freedoms)] = rates[name]
            if segment.coordinates is None:
                values[f"{name}_position"] = positions[name]
            else:
                values["q"][segment.coordinates] = positions[name]
    return values


def random_state(mechanism: Mechanism, seed: int = 3) -> tuple[dict[str, Any], dict[str, Any]]:
    rng, positions, rates = np.random.default_rng(seed), dict[str, Any](), dict[str, Any]()
    for segment in mechanism.segments:
        joint = segment.link.joint
        rates[joint.name] = rng.normal(size=joint.dofs)
        T = pose(rng)
        element = {tx.SO3: T[:3, :3], tx.SE3: T}.get(joint.group) if joint.group is not None else None
        positions[joint.name] = rng.normal(size=joint.dofs) if element is None else element
    return positions, rates


def terms(mechanism: Mechanism) -> dict[str, tx.Expr]:
    return {"M": mechanics.mass_matrix(mechanism), "b": mechanics.bias_forces(mechanism)}


def near(value: Any, expected: Any, bound: float = 1e-12) -> None:
    scale = max(float(np.max(np.abs(expected), initial=0.0)), 1e-3)
    assert np.max(np.abs(np.asarray(value) - expected), initial=0.0) <= bound * scale


# ---- lock ------------------------------------------------------------------------------------------------------------


def test_locked_joints_as_pinocchio_reduces_them() -> None:
    pin = pytest.importorskip("pinocchio", reason="pinocchio is not installed (extra twistax[peers])")
    model = pin.buildModelFromUrdf(str(EXAMPLES / "panda.urdf"))
    rng, arm = np.random.default_rng(0), panda()
    q = rng.uniform(-1.0, 1.0, size=model.nq)
    gone = ["joint2", "joint5", "joint7"]
    numbers = {name: model.joints[model.getJointId(name)].idx_q for name in gone}
    reduced = pin.buildReducedModel(model, [model.getJointId(name) for name in gone], q)
    locked = arm.lock({name: q[i] for name, i in numbers.items()})
    assert locked.joints == ("joint1", "joint3", "joint4", "joint6")
    assert locked.driven == locked.joints
    left, qd = q[[0, 2, 3, 5]], rng.normal(size=4)
    data = reduced.createData()
    values = evaluated(terms(locked), {"q": left, "qd": qd})
    near(values["b"], pin.rnea(reduced, data, left, qd, np.zeros(4)))
    M = np.triu(pin.crba(reduced, data, left))
    near(values["M"], M + np.triu(M, 1).T)


@pytest.mark.parametrize("names", [["ball", "table"], ["root", "slide", "screw"], ["rod", "cardan_1"]])
@pytest.mark.parametrize("make", [free_tree, mimicking_tree])
def test_a_locked_joint_is_one_that_does_not_move(make: Any, names: list[str]) -> None:
    # The mass matrix and the bias of the other freedoms are those of the whole tree at rest in the locked ones.
    tree: Tree = make()
    whole = tree.mechanism
    positions, rates = random_state(whole)
    rates |= {name: 0.0 * rates[name] for name in names}
    if "slide" in names:  # the follower is at rest as well
        rates["hinge"] = 0.0 * rates["hinge"]
    locked = whole.lock({name: positions[name] for name in names})
    assert set(locked.frames) == set(whole.frames)
    before, after = (evaluated(terms(m), inputs(m, positions, rates)) for m in (whole, locked))
    left = [i for name in locked.joints for i in whole.segment_of(name).freedoms]
    left = list(dict.fromkeys(left))
    near(after["M"], before["M"][np.ix_(left, left)])
    near(after["b"], before["b"][left])


def test_a_lock_at_a_parameter() -> None:
    angle = tx.Parameter("angle", value=0.3)
    arm = mechanics.chain_models.equal_links(3)
    tip = arm.lock({"joint1": angle}).pose("joint2")
    T = np.asarray(tx.lower(tip)(0.0, {"q": np.array([0.1, 0.2])}, params={"angle": 0.7}))
    expected = np.asarray(tx.lower(arm.pose("joint2"))(0.0, {"q": np.array([0.1, 0.7, 0.2])}))
    near(T, expected)


def test_locks_outside_of_limits_are_noted() -> None:
    assert panda().lock({"joint4": 0.0}).notes == ("joint 'joint4' is locked at [0.0], outside of its limits",)
    assert panda().lock({"joint4": -1.0}).notes == ()


def test_what_cannot_be_locked(unchecked: None) -> None:
    arm, tree = panda(), mimicking_tree().mechanism
    with pytest.raises(ModelError, match=r"joint9.*known are"):
        arm.lock({"joint9": 0.0})
    with pytest.raises(ModelError, match=r"the position of 'joint1' to be finite"):
        arm.lock({"joint1": np.nan})
    with pytest.raises(ShapeError, match=r"'joint1' with shape \(1,\)"):
        arm.lock({"joint1": np.zeros(2)})
    with pytest.raises(ModelError, match="'hinge' mimics 'slide'"):
        tree.lock({"hinge": 0.0})
    with pytest.raises(ModelError, match="'ball' to be a rotation"):
        tree.lock({"ball": np.diag([1.0, 1.0, -1.0])})
    with pytest.raises(ModelError, match="constant during the motion"):
        arm.lock({"joint1": tx.State("other")})
    with pytest.raises(ModelError, match="expects positions by the names of joints"):
        arm.lock("joint1")  # type: ignore[arg-type]
    with pytest.raises(ModelError, match=r"no moving joint 'joint9'.*\n  fix: did you mean 'joint7'\?"):
        arm.lock({"joint9": 0.0})
    with pytest.raises(ModelError, match="connects two frames of one body"):
        four_bar().lock({"crank": 0.0, "coupler": 0.0, "rocker": 0.0})


# ---- attach, without, renamed, with_inertia --------------------------------------------------------------------------


def four_bar() -> Mechanism:
    y, out = (0.0, 1.0, 0.0), lambda x: tx.pose(position=[x, 0.0, 0.0])
    rod = SpatialInertia(mass=1.0, center_of_mass=(0.2, 0.0, 0.0), inertia=np.diag([0.01, 0.05, 0.05]))
    return Mechanism(
        [
            Link(joints.Revolute("crank", y), rod, out(0.0), drive=Drive(effort=3.0)),
            Link(joints.Revolute("coupler", y), rod, out(0.4), parent="crank"),
            Link(joints.Fixed("pin"), None, out(1.0), parent="coupler"),
            Link(joints.Revolute("rocker", y), rod, out(0.9)),
            Link(joints.Fixed("tip"), None, out(0.8), parent="rocker"),
        ],
        loops=[loops.AxisLoop("closure", "pin", "tip", y)],
        driven=["crank"],
    )


def test_attached_as_pinocchio_appends() -> None:
    pin = pytest.importorskip("pinocchio", reason="pinocchio is not installed (extra twistax[peers])")
    rng = np.random.default_rng(1)
    T = pose(rng)
    urdf = (EXAMPLES / "panda.urdf").read_text().replace('<joint name="flange"', '<joint name="mounting"')
    named = re.sub(r'(name|link)="', r'\1="second_', urdf)
    model, second = pin.buildModelFromXML(urdf), pin.buildModelFromXML(named)
    both = pin.appendModel(model, second, model.getFrameId("flange"), pin.SE3(T))
    arm = panda()
    ours = arm.attach(arm.renamed("second_"), "flange", T)
    assert ours.joints == (*arm.joints, *(f"second_{name}" for name in arm.joints))
    order = [both.joints[both.getJointId(name)].idx_q for name in ours.joints]
    q, qd, data = rng.normal(size=14), rng.normal(size=14), both.createData()
    theirs, rates = np.zeros(14), np.zeros(14)
    theirs[order], rates[order] = q, qd
    values = evaluated(terms(ours), {"q": q, "qd": qd})
    near(values["b"], pin.rnea(both, data, theirs, rates, np.zeros(14))[order])
    M = np.triu(pin.crba(both, data, theirs))
    near(values["M"], (M + np.triu(M, 1).T)[np.ix_(order, order)])


def test_the_body_of_a_base_moves_once_it_is_attached(tmp_path: Path) -> None:
    """The root link of a file, such as the palm of a hand, beside Pinocchio; and the old base of a rerooted arm."""
    pin = pytest.importorskip("pinocchio", reason="pinocchio is not installed (extra twistax[peers])")
    urdf = """<robot name="hand"><link name="palm"><inertial><origin xyz="0.1 0.2 0.3"/><mass value="0.4"/>
        <inertia ixx="0.03" iyy="0.02" izz="0.04" ixy="0.001" ixz="0" iyz="0"/></inertial></link>
        <link name="finger"><inertial><mass value="0.1"/>
        <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
        <joint name="knuckle" type="continuous"><parent link="palm"/><child link="finger"/><axis xyz="0 1 0"/></joint>
        </robot>"""
    (tmp_path / "hand.urdf").write_text(urdf)
    rng = np.random.default_rng(4)
    hand, T = mechanics.load(tmp_path / "hand.urdf"), pose(rng)
    text = (EXAMPLES / "panda.urdf").read_text().replace('<joint name="flange"', '<joint name="mounting"')
    arm = pin.buildModelFromXML(text)
    both = pin.appendModel(arm, pin.buildModelFromXML(urdf), arm.getFrameId("flange"), pin.SE3(T))
    q, qd, data = rng.normal(size=8), rng.normal(size=8), both.createData()
    q_of_theirs = pin.neutral(both)
    q_of_theirs[:7], q_of_theirs[7:] = q[:7], [np.cos(q[7]), np.sin(q[7])]
    ours = panda().attach(hand.renamed("right_"), "flange", T)
    values = evaluated(terms(ours), {"q": q, "qd": qd})
    near(values["b"], pin.rnea(both, data, q_of_theirs, qd, np.zeros(8)))
    M = np.triu(pin.crba(both, data, q_of_theirs))
    near(values["M"], M + np.triu(M, 1).T)
    turned = hand.rerooted("finger")
    assert turned.link("palm").body is hand.base_body
    assert turned.base_body is None
    # Whatever else is done with the hand, its palm has its mass.
    note = "the mass of 'palm', which has no effect while it does not move"
    assert note in hand.notes
    assert note not in ours.notes
    assert note not in hand.with_inertia({"palm": None}).notes
    load = SpatialInertia(mass=0.3, inertia=0.01 * np.eye(3))
    palm = hand.base_body
    assert palm is not None
    (tmp_path / "hand.xml").write_text(hand.to_mjcf())
    rod = hand.with_inertia({"palm": SpatialInertia(mass=1.0, inertia=np.diag([0.0, 0.0, 1.0]), physical=False)})
    with pytest.raises(ModelError, match="base_body: of 'palm'"):
        rod.to_mjcf()
    assert 'name="palm"' in rod.to_mjcf(leave_out=["base_body"])
    for other, mass in (
        (pickle.loads(pickle.dumps(hand)), 0.5),
        (hand.lock({"knuckle": 0.3}), 0.5),
        (hand.renamed("left_").replace(gravity=np.zeros(3)), 0.5),
        (mechanics.load(tmp_path / "hand.xml"), 0.5),
        (hand.with_inertia({"palm": palm + load}), 0.8),
        (hand.with_inertia({"palm": None}), 0.1),
    ):
        whole = panda().attach(other.renamed("a_"), "flange")
        masses = evaluated([mechanics.total_mass(m) for m in (whole, panda())], {})
        near(masses[0] - masses[1], mass)


def test_two_mechanisms_on_one_base_keep_closures_motors_and_limits() -> None:
    arm, linkage = panda(), four_bar()
    both = arm.attach(linkage.renamed("left_"), pose=tx.pose(position=[1.0, 0.0, 0.0]))
    both = both.attach(linkage.renamed("right_"), "left_rocker")
    assert both.driven == (*arm.driven, "left_crank", "right_crank")
    assert [(loop.name, loop.frame, loop.other) for loop in both.loops] == [
        ("left_closure", "left_pin", "left_tip"),
        ("right_closure", "right_pin", "right_tip"),
    ]
    assert np.array_equal(both.q.min[:7], arm.q.min)
    assert both.motors(["left_crank"]).max == [3.0]
    rng = np.random.default_rng(2)
    q, qd = rng.normal(size=both.dofs), rng.normal(size=both.dofs)
    M = evaluated(terms(both), {"q": q, "qd": qd})["M"]
    near(M[:7, :7], evaluated(terms(arm), {"q": q[:7], "qd": qd[:7]})["M"])
    assert np.abs(M[:7, 7:]).max() == 0.0
    assert np.abs(M[7:10, 10:]).max() > 0.1
    assert both.without("left_base").joints == arm.joints


def test_what_cannot_be_attached(unchecked: None) -> None:
    arm, linkage = panda(), four_bar()
    with pytest.raises(ModelError, match=r"both mechanisms have frames named 'flange', 'link0'.*(\n.*)*renamed"):
        arm.attach(arm)
    with pytest.raises(ModelError, match="no link 'hand'"):
        arm.attach(linkage, "hand")
    with pytest.raises(ModelError, match=r"expects another Mechanism(.|\n)*with_inertia"):
        arm.attach("linkage")  # type: ignore[arg-type]
    with pytest.raises(ModelError, match="different loop metrics"):
        linkage.attach(linkage.renamed("b_").replace(loop_metric=loops.Metric(length=2.0)))


def test_without_a_branch_it_is_the_tree_without_it() -> None:
    tree = free_tree()
    left = [link for link in tree.mechanism.links if link.name not in ("rod", "ball", "screw", "tool")]
    rest = tree.mechanism.without("rod")
    assert rest.frames.keys() == {"base", *(link.name for link in left)}
    state = inputs(rest, *random_state(rest))
    by_hand = evaluated(terms(Mechanism(left, tree.mechanism.gravity)), state)
    near(evaluated(terms(rest), state)["M"], by_hand["M"])
    body = body_of(Cloud.random(np.random.default_rng(0)))
    follower = Link(joints.Revolute("hinge", Z), body, np.eye(4), mimic=mechanics.Mimic("slide"))
    led = Mechanism([Link(joints.Prismatic("slide", Z), body, np.eye(4)), follower])
    with pytest.raises(ModelError, match="'hinge' mimics 'slide', which would be removed"):
        led.without("slide")
    with pytest.raises(ModelError, match="'closure', 'pin', 'tip'"):
        four_bar().without("rocker")
    with pytest.raises(ModelError, match="the mechanism would have no links"):
        panda().without("link1")


def test_a_renamed_mechanism_is_the_same_one() -> None:
    tree, linkage = mimicking_tree().mechanism, four_bar().renamed("a_")
    assert linkage.base == "a_base"
    assert linkage.driven == ("a_crank",)
    assert mechanics.loop_gap(linkage, "a_closure").shape == (5,)
    named = tree.renamed("b_")
    assert named.q.keys() == {"q", "b_root", "b_ball"}
    assert named.q["b_root"].name == "b_root_position"
    positions, rates = random_state(tree)
    before = evaluated(terms(tree), inputs(tree, positions, rates))
    after = evaluated(
        terms(named), inputs(named, *({f"b_{name}": v for name, v in part.items()} for part in (positions, rates)))
    )
    near(after["M"], before["M"])
    near(after["b"], before["b"])
    with pytest.raises(ModelError, match="expects a prefix"):
        tree.renamed("")


def test_a_body_in_place_of_another() -> None:
    arm = panda()
    payload = SpatialInertia(mass=2.0, center_of_mass=(0.0, 0.0, 0.1), inertia=0.01 * np.eye(3))
    hand = arm.link("link7").body
    assert hand is not None
    heavy = arm.with_inertia({"joint7": hand + payload})
    by_hand = arm.attach(Mechanism([Link(joints.Fixed("load"), payload, np.eye(4))], base="load base"), "link7")
    state = {"q": np.linspace(-1.0, 1.0, 7), "qd": np.ones(7)}
    near(evaluated(terms(heavy), state)["b"], evaluated(terms(by_hand), state)["b"])
    masses = {name: mechanics.total_mass(m) for name, m in (("arm", arm), ("heavy", heavy))}
    masses["light"] = mechanics.total_mass(arm.with_inertia({"link7": None}))
    m = evaluated(masses, {})
    near([m["heavy"] - m["arm"], m["arm"] - m["light"]], [2.0, float(hand.mass.value)])
    with pytest.raises(ModelError, match="no link 'hand'"):
        arm.with_inertia({"hand": None})
