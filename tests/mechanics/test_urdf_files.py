"""URDF that says a thing twice, says what URDF does not have, or says it as programs write it."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import twistax as tx
from evaluated import evaluated
from twistax import mechanics
from twistax.mechanics import Mechanism, load


def inertial(mass: Any = 1, moments: str = "1 1 1", products: str = "0 0 0", at: str = "0.1 0 0.2") -> str:
    xx, yy, zz = moments.split()
    xy, xz, yz = products.split()
    return (
        f'<inertial><origin xyz="{at}"/><mass value="{mass}"/>'
        f'<inertia ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="{xy}" ixz="{xz}" iyz="{yz}"/></inertial>'
    )


def link(name: str, inside: str = "") -> str:
    return f'<link name="{name}">{inside}</link>\n'


def joint(name: str, parent: str, child: str, inside: str = "", kind: str = "continuous") -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0 0.3 0.1" rpy="0.2 0 0.5"/><axis xyz="0 0 1"/>{inside}</joint>\n'
    )


def robot(folder: Path, *parts: str, before: str = "", attributes: str = "", **options: Any) -> Mechanism:
    path = folder / "robot.urdf"
    path.write_text(f'{before}<robot name="r"{attributes}>\n{"".join(parts)}</robot>\n')
    return load(path, **options)


#: A base and a link with a mass, in lines 2 and 3.
PAIR = (link("base"), link("rod", inertial()))


def acceleration(mechanism: Mechanism, torque: float = 1.0) -> np.ndarray:
    """In a posture of zeros, at rest and without gravity."""
    n, afloat = mechanism.dofs, mechanism.replace(gravity=(0.0, 0.0, 0.0))
    return np.asarray(evaluated(mechanics.aba(afloat, np.zeros(n), np.zeros(n), np.full(n, torque))))


# ---- refused ---------------------------------------------------------------------------------------------------------

TWICE = '<limit lower="0" upper="1" effort="1" velocity="1"/>'


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ((*PAIR, link("rod", inertial(7)), joint("j", "base", "rod")),
         r"line 4, <link name='rod'>: a link of this name is already in line 3(.|\n)*fix: give one of the two"),
        ((*PAIR, link("tip"), joint("j", "base", "rod"), joint("j", "rod", "tip")),
         r"line 6, <joint name='j'>: a joint of this name is already in line 5(.|\n)*fix: give one"),
        ((link("base"), link("rod", f"{inertial()}\n{inertial(7)}"), joint("j", "base", "rod")),
         r"<link name='rod'>, line 4, <inertial>: <inertial> occurs twice in <link name='rod'>, in line 3"),
        ((link("base"), link("rod", inertial().replace("<mass", '<mass value="2"/><mass')), joint("j", "base", "rod")),
         r"<link name='rod'>, line 3, <mass>: <mass> occurs twice in <inertial>, in line 3"),
        *(((*PAIR, joint("j", "base", "rod", again)), rf"<joint name='j'>, line 4, <{tag}>: <{tag}> occurs twice")
          for tag, again in (("origin", '<origin xyz="1 0 0"/>'), ("axis", '<axis xyz="1 0 0"/>'),
                             ("limit", TWICE + TWICE), ("parent", '<parent link="a"/>'), ("child", "<child/>"),
                             ("dynamics", "<dynamics/><dynamics/>"), ("mimic", '<mimic joint="k"/><mimic/>'))),
        ((link("base"), link("rod", "<visual><geometry/><geometry/></visual>"), joint("j", "base", "rod")),
         r"line 3, <geometry>: <geometry> occurs twice in <visual>"),
        ((*PAIR, joint("j", "base", "rod"), '<xacro:leg side="left"/>'),
         r"line 5, <xacro:leg>: <xacro:leg> is a macro(.|\n)*`xacro robot.urdf.xacro > robot.urdf`"),
        ((link("base"), link("rod", inertial("${mass}")), joint("j", "base", "rod")),
         r"<link name='rod'>, line 3, <mass>: value='\${mass}' is a macro of xacro(.|\n)*xacro robot.urdf.xacro"),
        ((*PAIR, joint("j", "base", "rod").replace("0.2 0 0.5", "$(optenv TILT 0 0 0)")),
         r"<joint name='j'>, line 4, <origin>: rpy='\$\(optenv TILT 0 0 0\)' is a macro"),
        ((*PAIR, joint("j", "base", "rod").replace("rpy", 'quat_xyzw="0 0 1 0" rpy')), "line 4, <origin>: quat_xyzw"),
        ((*PAIR, joint("j", "base", "rod"), joint("k", "base", "rod")),
         r"line 5, <joint name='k'>: link 'rod' has two joints that carry it, the other in line 4"),
        ((*PAIR, link("spare"), joint("j", "base", "rod")),
         r"line 4, <link name='spare'>: no joint carries this link, and none carries 'base'(.|\n)*fix: join"),
        ((*PAIR, link("a"), link("b"), joint("j", "base", "rod"), joint("k", "a", "b"), joint("l", "b", "a")),
         r"<joint name='k'>: the links form a cycle: 'a', 'b'|<joint name='l'>: links carry each other"),
        ((*PAIR, joint("j", "base", "rod", '<mimic joint="shuolder"/>'), link("c"), joint("shoulder", "rod", "c")),
         r"line 4, <joint name='j'>: it mimics 'shuolder', but there is no joint(.|\n)*did you mean 'shoulder'"),
        ((*PAIR, joint("j", "base", "rod", '<mimic joint="k"/>'), link("c"), joint("k", "rod", "c", "", "fixed")),
         r"line 4, <joint name='j'>: it mimics 'k', whose type fixed"),
        ((*PAIR, joint("j", "base", "rod", '<mimic joint="j"/>')), r"<joint name='j'>: .*form a cycle"),
        ((*PAIR, joint("j", "base", "rod", '<limit effort="-2" velocity="1"/>')),
         r"line 4, <joint name='j'>: Drive expects effort"),
        ((*PAIR, joint("j", "base", "rod").replace("0 0 1", "0 0 0")), r"<joint name='j'>: .*axis"),
        ((*PAIR, joint("j", "base", "rod", kind="planar").replace("0 0 1", "0 0 0")), r"<joint name='j'>: .*axis"),
    ],
)  # fmt: skip
def test_refused_with_file_element_line_and_remedy(parts: tuple[str, ...], message: str, tmp_path: Path) -> None:
    with pytest.raises(tx.ModelError, match=rf"^robot\.urdf, (in )?(.|\n)*{message}"):
        robot(tmp_path, *parts)


def test_a_single_link_is_at_rest_or_free(tmp_path: Path) -> None:
    at_rest = robot(tmp_path, link("base", inertial()))
    assert at_rest.dofs == 0
    assert [own.name for own in at_rest.links] == ["base"]
    assert "no joint moves; floating=True frees the root link" in at_rest.notes
    with pytest.raises(tx.ModelError, match="expects a mechanism with a joint that moves"):
        at_rest.system()
    free = robot(tmp_path, link("base", inertial()), floating=True)
    assert free.dofs == 6


# ---- noted -----------------------------------------------------------------------------------------------------------


def test_what_is_not_known_is_noted(tmp_path: Path) -> None:
    loaded = robot(
        tmp_path,
        link("base", "<collision/>"),
        link("rod", inertial() + '<contact mu="1"/>'),
        joint("j", "base", "rod", '<dynamics dampping="3"/>').replace("rpy", "RPY"),
        "<gazebo><xacro:kept/></gazebo>",
        attributes=' xmlns:xacro="http://wiki.ros.org/xacro"',
    )
    assert loaded.notes == (
        "<contact> of <link>, which URDF does not have: line 3",
        "<gazebo> of <robot>: line 5",
        "attribute 'RPY' of <origin>, which URDF does not have (did you mean 'rpy'?): line 4",
        "attribute 'dampping' of <dynamics>, which URDF does not have (did you mean 'damping'?): line 4",
        "no distances (clearances): <collision> that cannot be read, of the links 'base'",
    )


def test_a_spherical_joint_is_a_ball(tmp_path: Path) -> None:
    """URDF has none; Bullet and MuJoCo read it."""
    loaded = robot(tmp_path, *PAIR, joint("j", "base", "rod", kind="spherical"))
    assert isinstance(loaded.segments[0].link.joint, mechanics.joints.Spherical)
    assert loaded.notes == ("joints of the type spherical, which URDF does not have and Bullet and MuJoCo read: 'j'",)


def test_limits_that_stand_for_something_else(tmp_path: Path) -> None:
    """Below the lower one is no limit by convention; zeros are limits, and said to be."""
    limits = [
        '<limit lower="1" upper="-1" effort="0" velocity="3"/>',
        '<limit lower="-1" upper="2" effort="4" velocity="0"/>',
        '<limit lower="-1" upper="2" effort="0" velocity="3"/>',
    ]
    loaded = robot(
        tmp_path, *PAIR, link("c", inertial()), link("d", inertial()), joint("i", "base", "rod", limits[0], "revolute"),
        joint("j", "rod", "c", limits[1], "prismatic"), joint("k", "c", "d", limits[2]),
    )  # fmt: skip
    np.testing.assert_array_equal(loaded.q.min, [-np.inf, -1.0, -np.inf])
    np.testing.assert_array_equal(loaded.q.max, [np.inf, 2.0, np.inf])
    np.testing.assert_array_equal(loaded.motors(loaded.driven).max, [0.0, 4.0, 0.0])
    assert loaded.notes == (
        "effort 0, which many programs write where it is not known, taken as the limit of joints 'i', 'k'",
        "lower above upper, which by convention stands for no limits, of joints 'i'",
        "velocity 0, which many programs write where it is not known, taken as the limit of joints 'j'",
        "lower and upper of the continuous joints 'k'",
    )


@pytest.mark.parametrize("before", ["\n", "\ufeff", "\r\n  \n", "\ufeff\n", "\n\ufeff"])
def test_an_empty_line_or_a_mark_before_the_declaration(before: str, tmp_path: Path) -> None:
    """Lines in messages are those of the file."""
    declaration = before + '<?xml version="1.0" encoding="utf-8"?>'
    loaded = robot(tmp_path, *PAIR, joint("j", "base", "rod"), before=declaration)
    noted = ("white space before the XML declaration of 'robot.urdf'",)
    assert loaded.notes == (noted if "\n" in before else ())
    line = before.count("\n") + 4
    with pytest.raises(tx.ModelError, match=rf"line {line}, <joint name='j'>: expected the type"):
        robot(tmp_path, *PAIR, joint("j", "base", "rod", kind="ball"), before=declaration)
    with pytest.raises(tx.ModelError, match=rf"line {line}: this is not XML"):
        robot(tmp_path, *PAIR, "<open>", before=declaration)


def test_null_characters_after_the_end(tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    robot(tmp_path, *PAIR, joint("j", "base", "rod"))
    path.write_bytes(path.read_bytes() + b"\0\0\n")
    assert load(path).notes == ("null characters after the end of 'robot.urdf'",)


def test_a_chain_of_followers_follows_the_first(tmp_path: Path) -> None:
    """q_3 = 3 q_2 + 0.3, q_2 = -2 q_1 + 0.2."""
    loaded = robot(
        tmp_path, *PAIR, link("c", inertial()), link("d", inertial()),
        joint("one", "base", "rod"),
        joint("three", "c", "d", '<mimic joint="two" multiplier="3" offset="0.3"/>'),
        joint("two", "rod", "c", '<mimic joint="one" multiplier="-2" offset="0.2"/>'),
    )  # fmt: skip
    assert loaded.dofs == 1
    assert loaded.notes == ("joints that follow in a chain: 'three' -> 'two' -> 'one'; here 'three' follows 'one'",)
    free = robot(
        tmp_path, *PAIR, link("c", inertial()), link("d", inertial()),
        joint("one", "base", "rod"), joint("three", "c", "d"), joint("two", "rod", "c"),
    )  # fmt: skip
    by_name = {"one": 0.7, "two": -2.0 * 0.7 + 0.2, "three": 3.0 * (-2.0 * 0.7 + 0.2) + 0.3}
    expected = evaluated(free.pose("d"), {"q": np.array([by_name[name] for name in free.joints])})
    np.testing.assert_allclose(evaluated(loaded.pose("d"), {"q": np.array([0.7])}), expected, atol=1e-12)


@pytest.mark.parametrize("name", ["root", "world"])
def test_a_free_root_beside_a_joint_or_link_of_the_name_that_it_gets(name: str, tmp_path: Path) -> None:
    loaded = robot(
        tmp_path, link("base", inertial()), link("world", inertial()), joint(name, "base", "world"), floating=True
    )
    free = "root (2)" if name == "root" else "root"
    assert loaded.joints == (free, name)
    assert set(loaded.frames) == {"world (2)", "base", "world"}
    assert any("'root (2)'" in note for note in loaded.notes) == (name == "root")
    assert loaded.system().states


# ---- masses and inertias ---------------------------------------------------------------------------------------------


def test_round_off_in_an_inertia_is_none(tmp_path: Path) -> None:
    """A point mass: m r^2 about the axis. The same entries of a mass that is as small are no round-off."""
    parts = link("base"), link("rod", inertial(1.3, "0 0 0", "0 2.4e-35 -1e-20")), joint("j", "base", "rod")
    loaded = robot(tmp_path, *parts)
    assert loaded.notes == ("inertias that are round-off, here zero: of 'rod'",)
    np.testing.assert_allclose(acceleration(loaded), 1.0 / (1.3 * 0.1**2), rtol=1e-12)
    bare = inertial(1.3, "0 0 0", "0 2.4e-35 0", at="0 0 0")
    robot(tmp_path, link("base"), link("rod", bare), joint("j", "base", "rod").replace("0 0.3 0.1", "0 0 0"))
    with pytest.raises(tx.ModelError, match="link 'rod' has a mass or inertia that no body has"):
        robot(tmp_path, link("base"), link("rod", inertial(1e-19, "0 0 0", "0 0 -1e-20")), joint("j", "base", "rod"))


FIXED = joint("weld", "rod", "pad", kind="fixed")


@pytest.mark.parametrize(("order", "parameters"), [((0, 1, 2, 3), False), ((0, 1, 2, 3), True), ((1, 2, 0, 3), False)])
def test_massless_links_that_are_fixed_are_merged(order: tuple[int, ...], parameters: bool, tmp_path: Path) -> None:
    """Inertia without mass is added, in whatever order the file has the links and joints."""
    pads = [link(name, inertial(0, "0.1 0.1 0.1")) for name in ("pad", "spot")]
    parts = [FIXED, joint("more", "rod", "spot", kind="fixed"), joint("end", "rod", "tip", kind="fixed"),
             joint("j", "base", "rod")]  # fmt: skip
    loaded = robot(
        tmp_path, link("base"), link("rod"), *pads, link("tip", inertial(2.0, at="0 0 0")),
        *(parts[i] for i in order), parameters=parameters,
    )  # fmt: skip
    reach = 0.3**2
    np.testing.assert_allclose(acceleration(loaded), 1.0 / (0.1 + 0.1 + 1.0 + 2.0 * reach), rtol=1e-12)
    assert sum("the links fixed to it make it one that is possible" in note for note in loaded.notes) == 2


def test_massless_links_at_rest_are_noted(tmp_path: Path) -> None:
    loaded = robot(tmp_path, link("base", inertial(0)), link("rod", inertial()), joint("j", "base", "rod"))
    assert "link 'base' has a mass or inertia that no body has; it does not move" in loaded.notes


def test_a_massless_link_that_moves_and_a_negative_mass_are_refused(tmp_path: Path) -> None:
    with pytest.raises(tx.ModelError, match=r"<link name='rod'>, line 3, <inertial>: link 'rod' has a mass"):
        robot(tmp_path, link("base"), link("rod", inertial(0)), joint("j", "base", "rod"))
    with pytest.raises(tx.ModelError, match="link 'pad' has a mass"):
        robot(tmp_path, *PAIR, link("pad", inertial(-0.1)), joint("j", "base", "rod"), FIXED)


def arm(rod: str, tip: str) -> tuple[str, ...]:
    return link("base"), link("rod", rod), link("tip", tip), joint("j", "base", "rod"), joint("k", "rod", "tip")


#: One moment above the sum of the others; and one that is negative.
WRONG = arm(inertial(1, "5 1 1"), inertial(1, "1 9 1"))
NEGATIVE = arm(inertial(1, "5 1 -1"), inertial(1, "1 9 -1"))


def taken(name: str, moments: str, hint: str = "") -> str:
    return (
        f"link '{name}' has a mass or inertia that no body has (1 kg, principal moments {moments} kg m2){hint}; it is "
        f"taken as it is, for the equations of motion have one solution. physical={{'{name}': True}} refuses it"
    )


def test_a_principal_moment_above_the_sum_of_the_others_is_noted(tmp_path: Path) -> None:
    """It moves as Newton and Euler say."""
    assert robot(tmp_path, *WRONG).notes == (taken("rod", "1, 1, 5"), taken("tip", "1, 1, 9"))
    path = tmp_path / "robot.urdf"
    path.write_text(f'<robot name="r">{link("rod", inertial(1, "5 1 1", at="0 0 0"))}</robot>')
    single = load(path, floating=True, gravity=(0.0, 0.0, 0.0))
    assert single.notes == (taken("rod", "1, 1, 5"),)
    w, torque, tensor = np.array([0.3, -0.7, 0.5]), np.array([1.0, 2.0, -3.0]), np.diag([5.0, 1.0, 1.0])
    still = np.zeros(3)
    qdd = mechanics.aba(single, {"root": tx.pose()}, np.concatenate([still, w]), np.concatenate([still, torque]))
    expected = np.linalg.solve(tensor, torque - np.cross(w, tensor @ w))
    np.testing.assert_allclose(evaluated(qdd)[3:], expected, rtol=1e-14)


@pytest.mark.parametrize(
    ("added", "note"), [("4 4 4", "make it one that is possible"), ("2 2 2", taken("rod", "1, 1, 5"))]
)
def test_a_principal_moment_is_judged_with_what_is_fixed_to_the_link(added: str, note: str, tmp_path: Path) -> None:
    """With 4 more the moments are 5, 5, 9, with 2 more 3, 3, 7."""
    pad = link("pad", inertial(1, added))
    weld = FIXED.replace("0 0.3 0.1", "0 0 0").replace("0.2 0 0.5", "0 0 0")
    (found,) = robot(
        tmp_path, link("base"), link("rod", inertial(1, "5 1 1")), pad, joint("j", "base", "rod"), weld
    ).notes
    assert note in found


def test_products_of_inertia_of_the_other_sign_are_recognised(tmp_path: Path) -> None:
    """2 on the diagonal and 0.9 beside it have 1.1, 1.1, 3.8; with -0.9 it is 0.2, 2.9, 2.9."""
    but = ", but has with the other sign of the products of inertia"
    (note,) = robot(tmp_path, *arm(inertial(), inertial(1, "2 2 2", "0.9 0.9 0.9"))).notes
    assert note == taken("tip", "1.1, 1.1, 3.8", but)
    with pytest.raises(tx.ModelError, match=f"link 'tip' has a mass or inertia that no body has{but}. SpatialInertia"):
        robot(tmp_path, *arm(inertial(), inertial(1, "2 2 2", "0.9 0.9 0.9")), physical=True)


@pytest.mark.parametrize("moments", ["0 1 2", "1e-12 1 2", "-1e-3 1 2"])
def test_inertias_that_are_not_positive_definite_are_refused(moments: str, tmp_path: Path) -> None:
    with pytest.raises(tx.ModelError, match=r"link 'tip' has a mass(.|\n)*physical={'tip': False}"):
        robot(tmp_path, *arm(inertial(), inertial(1, moments)))


def test_physical_is_chosen_by_link(tmp_path: Path) -> None:
    with pytest.raises(tx.ModelError, match=r"'rod' has(.|\n)*so have 'tip'(.|\n)*{'rod': False, 'tip': False}"):
        robot(tmp_path, *NEGATIVE)
    with pytest.raises(tx.ModelError, match=r"<link name='tip'>.*link 'tip' has(.|\n)*physical={'tip': False}"):
        robot(tmp_path, *NEGATIVE, physical={"rod": False})
    for physical in (False, {"rod": False, "tip": False}):
        for parts in (WRONG, NEGATIVE):
            assert robot(tmp_path, *parts, physical=physical).notes == tuple(
                f"link {name!r} has a mass or inertia that no body has, taken as it is" for name in ("rod", "tip")
            )
    with pytest.raises(tx.ModelError, match="link 'tip' has a mass"):  # as Parameters too
        robot(tmp_path, *NEGATIVE, physical={"rod": False}, parameters=True)


def test_physical_may_demand_a_body_that_there_can_be(tmp_path: Path) -> None:
    with pytest.raises(tx.ModelError, match=r"'rod' has(.|\n)*so have 'tip'(.|\n)*{'rod': False, 'tip': False}"):
        robot(tmp_path, *WRONG, physical=True)
    with pytest.raises(tx.ModelError, match=r"<link name='tip'>.*link 'tip' has(.|\n)*physical={'tip': False}"):
        robot(tmp_path, *WRONG, physical={"tip": True})


@pytest.mark.parametrize(
    ("physical", "message"),
    [
        ({"rodd": False}, r"physical names 'rodd'(.|\n)*did you mean 'rod'"),
        (
            {"rod": 0},
            r"expects physical=True, False, or a mapping of links such as {'tool': False}, got dict: {'rod': 0}",
        ),
        ("rod", "expects physical=True, False, or a mapping .* got 'rod'"),
    ],
)
def test_physical_that_is_no_choice_is_refused(physical: Any, message: str, tmp_path: Path, unchecked: None) -> None:
    with pytest.raises(tx.ModelError, match=message):
        robot(tmp_path, *WRONG, physical=physical)
