"""Model files: what is read, what becomes a Parameter, what is refused and where it says so."""

import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import twistax as tx
from evaluated import evaluated
from twistax import mechanics
from twistax.mechanics import load

OWN = Path(__file__).parents[2] / "examples"
#: A robot of one joint, with places to put something else.
ROBOT = """<robot name="r">
  <link name="a"/>
  <link name="b"><inertial><mass value="{mass}"/>
    <inertia ixx="{ixx}" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
  <joint name="j" type="{kind}"><parent link="a"/><child link="{child}"/><origin xyz="{xyz}"/>
    <axis xyz="0 0 1"/></joint>
</robot>"""


def written(folder: Path, text: str = ROBOT, **changes: str) -> Path:
    path = folder / "robot.urdf"
    given = {"mass": "1", "ixx": "1", "kind": "continuous", "child": "b", "xyz": "0 0 0", **changes}
    path.write_text(re.sub(r"\{(\w+)\}", lambda found: given[found[1]], text))
    return path


def test_limits_friction_and_notes_of_a_file() -> None:
    arm = load(OWN / "arm.urdf")
    assert arm.joints == ("shoulder", "elbow", "slide")
    np.testing.assert_array_equal(arm.q.min, [-np.inf, -2.0, 0.0])
    np.testing.assert_array_equal(arm.q.max, [np.inf, 1.5, 0.3])
    np.testing.assert_array_equal(arm.qd.max, [np.inf, 3.0, 0.5])
    drive = arm.segment_of("shoulder").link.drive
    assert (drive.damping, drive.friction) == (0.2, 0.05)
    assert arm.notes == ()
    assert arm.frame("tool").segment == 2
    (tau,) = arm.system().controls
    np.testing.assert_array_equal(tau.max, [np.inf, 40.0, 100.0])


def read_by_hand(path: Path, q: dict[str, float]) -> dict[str, np.ndarray]:
    """T (4, 4) of every link in the root's frame, by the standard library and SciPy: rpy turns about fixed axes."""
    tree, places = ElementTree.parse(path).getroot(), {}

    def origin(element: Any) -> np.ndarray:
        T, found = np.eye(4), element.find("origin")
        if found is not None:
            T[:3, 3] = [float(a) for a in found.get("xyz", "0 0 0").split()]
            T[:3, :3] = Rotation.from_euler("xyz", [float(a) for a in found.get("rpy", "0 0 0").split()]).as_matrix()
        return T

    joints = {joint.find("child").get("link"): joint for joint in tree.findall("joint")}

    def place(link: str) -> np.ndarray:
        if link not in joints:
            return np.eye(4)
        joint = joints[link]
        T, axis, value = np.eye(4), np.array([1.0, 0.0, 0.0]), q.get(joint.get("name"), 0.0)
        if joint.find("axis") is not None:
            axis = np.array([float(a) for a in joint.find("axis").get("xyz").split()])
        if joint.get("type") == "prismatic":
            T[:3, 3] = value * axis
        elif joint.get("type") != "fixed":
            T[:3, :3] = Rotation.from_rotvec(value * axis).as_matrix()
        return place(joint.find("parent").get("link")) @ origin(joint) @ T

    for link in tree.findall("link"):
        places[link.get("name")] = place(link.get("name"))
        inertial = link.find("inertial")
        if inertial is not None:
            m = {name: float(value) for name, value in inertial.find("inertia").attrib.items()}
            J = np.array([[m[f"i{min(a, b)}{max(a, b)}"] for b in "xyz"] for a in "xyz"])
            places[f"inertia of {link.get('name')}"] = J
            places[f"centre of {link.get('name')}"] = places[link.get("name")] @ origin(inertial)
            places[f"mass of {link.get('name')}"] = np.array(float(inertial.find("mass").get("value")))
    return places


@pytest.mark.parametrize(
    ("path", "values"),
    [
        (OWN / "arm.urdf", {"shoulder": [0.4], "elbow": [-0.7], "slide": [0.2]}),
        # The right finger follows the left one.
        (Path(__file__).parent / "models" / "hand.urdf", {"left_joint": [0.5], "thumb_joint": [-0.3]}),
    ],
)
def test_places_and_energies_of_a_file(path: Path, values: dict[str, list[float]]) -> None:
    robot = load(path, quarter_turns=0.0)
    q, rates = np.concatenate([values[name] for name in robot.joints if name in values]), np.array([0.6, -0.9, 0.7])

    def by_hand(q: np.ndarray) -> dict[str, np.ndarray]:
        named = dict(zip(values, q, strict=True))
        if "left_joint" in named:
            named["right_joint"] = 0.9 * named["left_joint"] + 0.1
        return read_by_hand(path, named)

    qd, e = rates[: len(q)], 1e-5
    here, after, before = by_hand(q), by_hand(q + e * qd), by_hand(q - e * qd)
    kinetic = potential = 0.0
    tips = [name for name in here if " of " not in name]
    # A root at rest carries no energy.
    for name in [name for name in tips if f"mass of {name}" in here and not np.array_equal(here[name], np.eye(4))]:
        mass, J, T = (here[f"{what} of {name}"] for what in ("mass", "inertia", "centre"))
        rate = (after[f"centre of {name}"] - before[f"centre of {name}"]) / (2.0 * e)
        turn = T[:3, :3].T @ rate[:3, :3]
        w, v = np.array([turn[2, 1], turn[0, 2], turn[1, 0]]), rate[:3, 3]
        kinetic += 0.5 * mass * v @ v + 0.5 * w @ J @ w
        potential += 9.81 * mass * T[2, 3]
    wanted = {name: robot.pose(name) for name in tips}
    wanted |= {"T": mechanics.kinetic_energy(robot), "V": mechanics.potential_energy(robot)}
    found = evaluated(wanted, {"q": q, "qd": qd})
    for name in tips:
        np.testing.assert_allclose(found[name], here[name], atol=1e-12)
    np.testing.assert_allclose(found["T"], kinetic, rtol=1e-8)
    np.testing.assert_allclose(found["V"], potential, rtol=1e-10)


def test_quarter_turns_are_taken_as_such_unless_told_otherwise() -> None:
    rounded, literal = load(OWN / "arm.urdf"), load(OWN / "arm.urdf", quarter_turns=0.0)
    mount = [each.segment_of("elbow").link.mount.value for each in (rounded, literal)]
    assert mount[0][1, 1] == 0.0
    assert 0.0 < abs(mount[1][1, 1]) < 1e-11


def test_numbers_of_a_file_become_parameters() -> None:
    """Other values, given to one compiled system, are those of a file that has them."""
    plain = load(OWN / "arm.urdf")
    names = ["tool_mass", "upper_inertia", "lower_center_of_mass", "elbow_origin", "slide_axis", "shoulder_damping"]
    arm = load(OWN / "arm.urdf", parameters=names)
    system = arm.system(
        outputs={"bearing": arm.segment_of("slide").link.joint.reaction(mechanics.joint_wrench(arm, "slide"))}
    )
    assert {leaf.name for leaf in system.parameters} == set(names)
    assert len(load(OWN / "arm.urdf", parameters=True).system().parameters) == 4 * 3 + 4 + 3 + 2
    dynamics, fixed = tx.compile(system, backend=tx.JAX()), tx.compile(plain.system(), backend=tx.JAX())
    rng = np.random.default_rng(0)
    x, u = {"q": rng.normal(size=3), "qd": rng.normal(size=3)}, {"tau": rng.normal(size=3)}
    np.testing.assert_allclose(dynamics(0.0, x, u)["qd"], fixed(0.0, x, u)["qd"], rtol=1e-11)
    # The axis may have any length; a turned one keeps the bearing's wrench free of work.
    other = {"slide_axis": np.array([0.0, 0.0, -3.0]), "tool_mass": np.array(0.7)}
    text = (OWN / "arm.urdf").read_text().replace('<mass value="0.2"/>', '<mass value="0.7"/>')
    assert '<axis xyz="1 0 0"/>' in text
    path = Path(str(OWN / "arm.urdf"))
    changed = load_text(text.replace('<axis xyz="1 0 0"/>', '<axis xyz="0 0 -1"/>'), path)
    again = tx.compile(changed.system(), backend=tx.JAX())
    np.testing.assert_allclose(dynamics(0.0, x, u, other)["qd"], again(0.0, x, u)["qd"], rtol=1e-11)
    bearing = np.asarray(dynamics.outputs(0.0, x, u, other)["bearing"])
    assert abs(bearing[2]) < 1e-12 < abs(bearing[0])


def load_text(text: str, near: Path) -> mechanics.Mechanism:
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / near.name
        path.write_text(text)
        return load(path)


def test_axis_as_a_parameter_has_the_subspaces_of_one_that_is_not() -> None:
    for kind in (mechanics.joints.Revolute, mechanics.joints.Prismatic):
        for axis in ([0.3, -2.0, 0.4], [0.0, 0.0, -5.0]):
            joint, plain = kind("a", tx.Parameter("n", value=np.array(axis))), kind("a", axis)
            parts = (joint.motion_subspace, joint.actuation_basis, joint.constraint_basis, joint.transform)
            H, h, carried, T = evaluated(parts, {"a_position": np.array([0.7])})
            np.testing.assert_allclose(H, plain.motion_subspace.value, atol=1e-15)
            np.testing.assert_allclose(h, plain.actuation_basis.value, atol=1e-15)
            np.testing.assert_allclose(carried.T @ H, 0.0, atol=1e-15)
            assert np.linalg.matrix_rank(np.hstack([h, carried])) == 6
            expected = evaluated(plain.transform, {"a_position": np.array([0.7])})
            np.testing.assert_allclose(T, expected, atol=1e-15)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"mass": "heavy"}, r"in <link name='b'>, line 3, <mass>: expected a finite number in value, got 'heavy'"),
        ({"mass": "-1"}, r"line 3, <inertial>: link 'b' has a mass(.|\n)*physical={'b': False}"),
        ({"ixx": "-5"}, r"line 3, <inertial>: link 'b' (.|\n)*not negative"),
        ({"kind": "ball"}, r"line 5, <joint name='j'>: expected the type(.|\n)*got 'ball'"),
        ({"child": "c"}, r"line 5, <joint name='j'>: there is no link 'c', the child of this joint"),
        ({"child": "a"}, r"line 5, <joint name='j'>: the links form a cycle: 'a'"),
        ({"xyz": "0 0"}, r"in <joint name='j'>, line 5, <origin>: expected 3 finite numbers in xyz, got '0 0'"),
        ({"xyz": "0 0 nan"}, r"line 5, <origin>: expected 3 finite numbers"),
    ],
)
def test_broken_files_say_where(changes: dict[str, str], message: str, tmp_path: Path) -> None:
    with pytest.raises(tx.ModelError, match=message):
        load(written(tmp_path, **changes)).system()


def test_inertias_that_no_body_has_are_taken_where_that_is_asked_for(tmp_path: Path) -> None:
    robot = load(written(tmp_path, ixx="5"), physical=False)
    assert any("'b' has a mass or inertia that no body has" in note for note in robot.notes)
    x: Any = np.zeros(1)
    np.testing.assert_allclose(evaluated(mechanics.aba(robot, x, x, np.ones(1))), [1.0])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('<!DOCTYPE robot [<!ENTITY a "b">]>\n<robot/>', "line 1: a document type or entity is declared"),
        ('<!DOCTYPE robot SYSTEM "/etc/passwd">\n<robot/>', "line 1: a document type or entity is declared"),
        ("<robot>\n<link name='a'>\n</robot>", "line 3: this is not XML: mismatched tag"),
        ("<sdf/>", "line 1, <sdf>: load expects"),
        ("<robot/>", "line 1, <robot>: there is no <link>"),
    ],
)
def test_what_is_no_model_is_refused(text: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(tx.ModelError, match=message):
        load(written(tmp_path, text))


def test_bad_arguments_are_named(tmp_path: Path) -> None:
    with pytest.raises(tx.ModelError, match="cannot read"):
        load(tmp_path / "nothing.urdf")
    with pytest.raises(tx.ModelError, match="expects the path of a file, got its text"):
        load((OWN / "arm.urdf").read_text())
    with pytest.raises(tx.ModelError, match=r"no parameter 'tool_mas'(.|\n)*did you mean 'tool_mass'"):
        load(OWN / "arm.urdf", parameters=["tool_mas"])
    with pytest.raises(tx.ModelError, match="parameters=True or a list of names, got 'tool_mass'"):
        load(OWN / "arm.urdf", parameters="tool_mass")


def test_the_panda_of_the_examples_is_that_of_the_chain_models() -> None:
    """To the last bit."""
    file = mechanics.load(Path(__file__).parents[2] / "examples" / "panda.urdf")
    for own, other in zip(file.segments, mechanics.chain_models.panda().segments, strict=True):
        pairs: list[Any] = [(own.link.mount, other.link.mount)]
        pairs += [(getattr(own.body, n), getattr(other.body, n)) for n in ("mass", "center_of_mass", "inertia")]
        for a, b in pairs:
            np.testing.assert_array_equal(a.value, b.value)
    assert file.notes == ()
