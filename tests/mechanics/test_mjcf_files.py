"""MJCF: which other files it may bring in, what of it is dropped and said so, and what moves nothing."""

import os
from pathlib import Path

import numpy as np
import pytest

import twistax as tx
from evaluated import evaluated
from twistax import mechanics
from twistax.mechanics import load

mujoco = pytest.importorskip("mujoco", reason="mujoco is not installed (extra twistax[models])")

#: A sixth of a cubic metre.
TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
ROD = '<inertial pos="0.1 0 0.2" mass="1" diaginertia="0.2 0.3 0.4"/>'


def model(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"<mujoco>\n{text}\n</mujoco>")
    return path


def beside(folder: Path) -> Path:
    """A model that includes a file and takes a mesh from folders beside its own."""
    (folder / "pack" / "meshes").mkdir(parents=True)
    (folder / "pack" / "meshes" / "m.obj").write_text(TETRAHEDRON)
    model(
        folder / "pack" / "parts" / "arm.xml",
        '<compiler meshdir="../meshes"/><asset><mesh name="m" file="m.obj"/></asset><worldbody><body name="arm">'
        '<joint name="j"/><geom type="mesh" mesh="m" density="6"/></body></worldbody>',
    )
    return model(folder / "pack" / "scenes" / "scene.xml", '<include file="../parts/arm.xml"/>')


def test_within_a_folder_files_beside_the_model_are_read(tmp_path: Path, unchecked: None) -> None:
    path = beside(tmp_path)
    for within in (tmp_path / "pack", str(tmp_path)):
        (body,) = load(path, within=within).bodies.values()
        np.testing.assert_allclose(evaluated(body.mass), 1.0, rtol=1e-6)
    with pytest.raises(
        tx.ModelError, match=r"line 2, <include>: the file '../parts/arm.xml' lies outside(.|\n)*within='.*pack'"
    ):
        load(path)
    with pytest.raises(tx.ModelError, match=r"within expects a folder that '.*scene.xml' is in, got '.*parts'"):
        load(path, within=str(tmp_path / "pack" / "parts"))
    with pytest.raises(tx.InputError, match="load: within expects a path, got 3"):
        load(path, within=3)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["../../secret.xml", "{absolute}", "link.xml", "inner/secret.xml", "loop.xml", "a\0b"])
def test_nothing_outside_of_the_folder_is_read(name: str, tmp_path: Path) -> None:
    """By a path upwards, an absolute one, a link of the file system to a file and to a folder; a circle of links."""
    secret = model(tmp_path / "secret.xml", f"<worldbody><body><joint/>{ROD}</body></worldbody>")
    folder = tmp_path / "pack" / "scenes"
    folder.mkdir(parents=True)
    (folder / "link.xml").symlink_to(secret)
    (folder / "inner").symlink_to(tmp_path)
    (folder / "loop.xml").symlink_to(folder / "loop.xml")
    name = name.format(absolute=secret).replace("\0", "&#x2400;")
    path = model(folder / "scene.xml", f'<include file="{name}"/>')
    for within in (None, tmp_path / "pack"):
        with pytest.raises(tx.ModelError, match=r"lies outside of the folder|cannot read|is not a path of a file"):
            load(path, within=within)


@pytest.mark.parametrize("way", ["../../m.obj", "link.obj", "far/m.obj"])
def test_no_mesh_outside_of_the_folder_is_read(way: str, tmp_path: Path) -> None:
    """MuJoCo opens the path that was looked at."""
    (tmp_path / "m.obj").write_text(TETRAHEDRON)
    path = model(
        tmp_path / "pack" / "scenes" / "scene.xml",
        f'<asset>\n<mesh name="m" file="{way}"/></asset><worldbody><body><joint/><geom type="mesh" mesh="m"/></body>'
        "</worldbody>",
    )
    (path.parent / "link.obj").symlink_to(tmp_path / "m.obj")
    (path.parent / "far").symlink_to(tmp_path)
    with pytest.raises(tx.ModelError, match=r"line 3, <mesh name='m'>: the file .* lies outside of the folder 'pack'"):
        load(path, within=tmp_path / "pack")
    assert load(path, within=tmp_path).dofs == 1


def test_links_within_the_folder_are_followed(tmp_path: Path) -> None:
    path = beside(tmp_path)
    os.symlink(tmp_path / "pack" / "parts" / "arm.xml", path.parent / "arm.xml")
    assert load(model(path, '<include file="arm.xml"/>'), within=tmp_path / "pack").dofs == 1


def test_what_is_dropped_is_noted(tmp_path: Path) -> None:
    path = model(
        tmp_path / "model.xml",
        f"<worldbody><body><joint name='h' stiffness='2' springyield='3'/>{ROD}</body></worldbody>"
        "<actuator><motor name='m' joint='h' delay='0.05' nsample='30'/></actuator>",
    )
    assert load(path).notes == (
        "actuator 'm' of joint 'h': the delay of its control, 0.05 s",
        "the yield of the spring of joint 'h'",
    )


def test_warnings_of_mujoco_are_notes(tmp_path: Path) -> None:
    path = model(
        tmp_path / "model.xml",
        f"<compiler settotalmass='3'/><worldbody><body name='b'><joint/>{ROD}</body></worldbody>",
    )
    loaded = load(path)
    assert any(note.startswith("MuJoCo warns: ") and "settotalmass" in note for note in loaded.notes)


@pytest.mark.parametrize("driven", ["a", "b", "c"])
def test_a_chain_of_joints_follows_one(driven: str, tmp_path: Path) -> None:
    """a = 0.2 - 2 b and c = 0.3 + 3 a, which is said first; the driven joint leads."""
    path = model(
        tmp_path / "model.xml",
        f"<worldbody><body><joint name='a' axis='1 0 0'/>{ROD}<body><joint name='b' axis='0 1 0' ref='10'/>{ROD}"
        f"<body name='tip'><joint name='c'/>{ROD}</body></body></body></worldbody>"
        "<equality><joint joint1='c' joint2='a' polycoef='0.3 3 0 0 0'/><joint name='x' joint1='b' joint2='c' "
        "polycoef='1 1 0 0 0' active='false'/><joint joint1='a' joint2='b' polycoef='0.2 -2 0 0 0'/>"
        f"<joint name='again' joint1='b' joint2='c'/></equality><actuator><motor joint='{driven}'/></actuator>",
    )
    robot, peer = load(path), mujoco.MjModel.from_xml_path(str(path))
    assert (robot.dofs, robot.driven) == (1, (driven,))
    assert "equality 'again', whose joints are related by others already" in robot.notes
    data, b = mujoco.MjData(peer), 0.4 + np.radians(10.0)
    angles = {"b": b, "a": 0.2 - 2.0 * 0.4, "c": 0.3 + 3.0 * (0.2 - 2.0 * 0.4)}
    for name, value in angles.items():
        data.joint(name).qpos = value
    mujoco.mj_forward(peer, data)
    active = np.asarray(data.efc_type) == int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)
    np.testing.assert_allclose(np.sort(np.abs(data.efc_pos[active]))[:2], 0.0, atol=1e-12)
    place = np.asarray(evaluated(robot.pose("tip"), {"q": np.array([angles[driven]])}))
    np.testing.assert_allclose(place[:3, :3], data.body("tip").xmat.reshape(3, 3), atol=1e-12)


def test_limits_that_a_file_switches_off_are_none(tmp_path: Path) -> None:
    body = (
        f"<worldbody><body><joint name='h' limited='true' range='-10 10'/>{ROD}</body></worldbody>"
        "<actuator><motor joint='h' ctrllimited='true' ctrlrange='-1 1'/></actuator>"
    )
    held = load(model(tmp_path / "held.xml", body))
    free = load(model(tmp_path / "free.xml", f"<option><flag limit='disable' clampctrl='disable'/></option>{body}"))
    assert held.q.max is not None
    assert held.motors(["h"]).max is not None
    assert free.q.max is None
    assert free.motors(["h"]).max is None


@pytest.mark.parametrize(
    ("flag", "name"), [("damper", "damping"), ("frictionloss", "friction"), ("spring", "stiffness")]
)
def test_forces_that_a_file_switches_off_are_none(flag: str, name: str, tmp_path: Path) -> None:
    joint = f"<joint name='h' damping='2' frictionloss='3' stiffness='4'/>{ROD}"
    path = model(
        tmp_path / "model.xml",
        f"<option><flag {flag}='disable'/></option><worldbody><body>{joint}</body></worldbody>",
    )
    drive = load(path).segments[-1].link.drive
    numbers = {"damping": 2.0, "friction": 3.0, "stiffness": 4.0, name: 0.0}
    assert {each: float(getattr(drive, each)) for each in numbers} == numbers


def test_a_scene_in_which_nothing_moves_has_frames(tmp_path: Path) -> None:
    path = model(
        tmp_path / "model.xml", "<worldbody><body name='table' pos='0 0 0.7'><geom size='1'/></body></worldbody>"
    )
    loaded = load(path)
    assert "there is no joint, so nothing moves" in loaded.notes
    np.testing.assert_array_equal(evaluated(loaded.pose("table"))[:3, 3], [0.0, 0.0, 0.7])
    with pytest.raises(tx.ModelError, match="system expects a mechanism with a joint that moves"):
        loaded.system()
    for function in (mechanics.mass_matrix, mechanics.bias_forces, mechanics.kinetic_energy):
        with pytest.raises(tx.ModelError, match="expects a mechanism with a joint that moves"):
            function(loaded)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            f"<worldbody>\n<body name='b'><joint/>{ROD}\n{ROD}</body></worldbody>",
            "line 3, <body name='b'>: .*'inertial' found 2",
        ),
        (
            f"<worldbody>\n<body name='b'><joint/>{ROD}</body>\n<body name='b'/></worldbody>",
            "<body name='b'>: .*repeated name",
        ),
        (
            f"<worldbody>\n<body name='b'><joint name='j'/><joint name='j'/>{ROD}</body></worldbody>",
            "<joint name='j'>: .*rep",
        ),
        (
            f"<worldbody>\n<body name='b'><joint dampping='1'/>{ROD}</body></worldbody>",
            "in <body name='b'>, line 3, <joint>",
        ),
    ],
)
def test_what_stands_twice_or_is_not_known_is_refused(text: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(tx.ModelError, match=message):
        load(model(tmp_path / "model.xml", text))


def test_a_mesh_that_a_mass_follows_from_is_read(tmp_path: Path) -> None:
    """A tetrahedron of four corners: a sixth of a cubic metre, its centre at a quarter."""
    (tmp_path / "shapes").mkdir()
    (tmp_path / "shapes" / "m.obj").write_text(TETRAHEDRON)
    path = tmp_path / "model.xml"
    path.write_text(
        '<mujoco><compiler meshdir="shapes"/><asset><mesh name="m" file="m.obj"/></asset><worldbody><body name="b">'
        '<joint name="j"/><geom type="mesh" mesh="m" density="6"/></body></worldbody></mujoco>'
    )
    (body,) = mechanics.load(path).bodies.values()
    np.testing.assert_allclose(body.mass.value, 1.0, rtol=1e-6)
    np.testing.assert_allclose(body.center_of_mass.value, 0.25 * np.ones(3), rtol=1e-6)
