"""Solids from files of triangles, the camera that follows a body, captions, and films."""

import importlib.util
import shutil
import struct
from pathlib import Path

import numpy as np
import pytest

import twistax as tx
from solutions import scene_of
from twistax.mechanics import load

needs_trimesh = pytest.mark.skipif(importlib.util.find_spec("trimesh") is None, reason="trimesh is not installed")
TIMES = np.linspace(0.0, 2.0, 5)
#: A tetrahedron of volume 1/6, its triangles turning right outwards.
CORNERS = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
URDF = """
<robot name="arm"><link name="wall"/><link name="rod">
  <inertial><origin xyz="0 0 -0.5"/><mass value="1"/><inertia ixx="0.1" iyy="0.1" izz="0.01"/></inertial>
  <visual><origin xyz="0 0 -0.5"/><geometry><mesh filename="{name}" scale="2 2 2"/></geometry>
    <material name="red"><color rgba="0.9 0.1 0.1 1"/></material></visual>
</link><joint name="hinge" type="continuous"><parent link="wall"/><child link="rod"/><axis xyz="0 1 0"/></joint></robot>
"""


def volume(shape: tx.view.Shape) -> float:
    corners, faces = shape.mesh()
    a, b, c = np.moveaxis(corners[faces], 1, 0)
    return float(np.sum(a * np.cross(b, c)) / 6.0)


def write_stl(path: Path) -> Path:
    """Binary STL by its specification: 80 bytes, the count, then a normal, three corners and two bytes a triangle."""
    triangles = b"".join(struct.pack("<12fH", *([0.0] * 3), *CORNERS[face].ravel(), 0) for face in FACES)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(bytes(80) + struct.pack("<I", len(FACES)) + triangles)
    return path


def write_obj(path: Path) -> Path:
    lines = [f"v {x} {y} {z}" for x, y, z in CORNERS] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in FACES]
    path.write_text("\n".join(lines))
    return path


@needs_trimesh
@pytest.mark.parametrize("write", [write_stl, write_obj])
def test_a_file_is_read_when_it_is_drawn(tmp_path: Path, write) -> None:
    path = write(tmp_path / f"solid.{write.__name__[-3:]}")
    assert volume(tx.view.Mesh(path)) == pytest.approx(1.0 / 6.0)
    assert volume(tx.view.Mesh(path, 2.0)) == pytest.approx(8.0 / 6.0)
    assert volume(tx.view.Mesh(path, (1.0, -1.0, 1.0))) == pytest.approx(1.0 / 6.0)  # mirrored, and not inside out
    with pytest.raises(tx.InputError, match="nowhere"):
        tx.view.Mesh("nowhere.stl").mesh()


def test_triangles_as_numbers() -> None:
    assert volume(tx.view.Mesh((CORNERS, FACES))) == pytest.approx(1.0 / 6.0)
    with pytest.raises(tx.InputError, match="triangles"):
        tx.view.Mesh((CORNERS, FACES + 1))
    with pytest.raises(tx.InputError, match="scale"):
        tx.view.Mesh((CORNERS, FACES), 0.0)


@needs_trimesh
@pytest.mark.parametrize("name", ["meshes/rod.stl", "package://arm/meshes/rod.stl"])
def test_meshes_of_urdf(tmp_path: Path, name: str) -> None:
    """Beside the file, and in a package of ROS: the folder of its name, or the one about the file."""
    write_stl(tmp_path / "meshes" / "rod.stl")
    path = tmp_path / "arm.urdf"
    path.write_text(URDF.format(name=name))
    robot = load(path)
    (rod,) = robot.links[0].shapes
    assert type(rod) is tx.view.Mesh
    assert volume(rod) == pytest.approx(8.0 / 6.0)
    np.testing.assert_array_equal(rod.at[:3, 3], [0.0, 0.0, -0.5])
    assert rod.color == (230, 26, 26)
    assert not any("not drawn" in note for note in robot.notes)


def test_a_mesh_outside_of_the_folder_is_not_opened(tmp_path: Path) -> None:
    write_stl(tmp_path / "outside.stl")
    path = tmp_path / "robot" / "arm.urdf"
    path.parent.mkdir()
    path.write_text(URDF.format(name="../outside.stl"))
    assert load(path).links[0].shapes == ()
    assert "not drawn: <mesh> of <visual>, 1 times" in load(path).notes
    assert [type(shape) for shape in load(path, within=tmp_path).links[0].shapes] == [tx.view.Mesh]


@pytest.mark.skipif(importlib.util.find_spec("mujoco") is None, reason="mujoco is not installed")
def test_meshes_of_mjcf_are_where_mujoco_has_them(tmp_path: Path) -> None:
    """MuJoCo moves the axes of a mesh to its centre of mass: corners in the axes of the body are those of the file."""
    write_stl(tmp_path / "rod.stl")
    path = tmp_path / "arm.xml"
    path.write_text("""<mujoco><asset><mesh name="rod" file="rod.stl"/></asset><worldbody><body name="arm">
        <joint axis="0 1 0"/><geom type="mesh" mesh="rod" pos="0.1 0.2 0.3"/></body></worldbody></mujoco>""")
    (link,) = load(path).links
    (rod,) = link.shapes
    found = {tuple(np.round(corner, 5)) for corner in rod.corners()}
    assert found == {tuple(np.round(corner + [0.1, 0.2, 0.3], 5)) for corner in CORNERS}


def moving(**choices) -> tx.view.Scene:
    poses = np.tile(np.eye(4), (5, 1, 1))
    poses[:, 0, 3] = 50.0 * TIMES
    outputs = {"speed": np.linspace(1.0, 3.0, 5), "wind": np.ones((5, 2))}
    box = tx.view.Box((1.0, 1.0, 1.0))
    choices = {"path": "none.html"} | choices
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tx.view.Scene, "save", lambda scene, path: path)
        return scene_of(TIMES, {"g": poses}, outputs=lambda: outputs, bodies={"g": box}, **choices)


def test_a_body_that_is_followed_fills_the_picture() -> None:
    """A box of 1 m on a path of 100 m is a speck without it."""
    assert moving().view_size == pytest.approx(moving().size)
    assert moving(follow="g").view_size == pytest.approx(4.0 * np.sqrt(3.0))
    with pytest.raises(tx.InputError, match="no body 'h'"):
        moving(follow="h")


def test_a_caption_goes_on_between_saved_times() -> None:
    scene = moving(caption=["speed", "wind"]).at(np.array([0.25, 1.0]))
    np.testing.assert_allclose(scene.caption["speed"][:, 0], [1.25, 2.0])
    assert scene.caption["wind"].shape == (2, 2)
    with pytest.raises(tx.InputError, match="'height'"):
        moving(caption="height")


def test_a_film_needs_a_browser_and_ffmpeg(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = moving()
    with pytest.raises(tx.InputError, match="two even numbers"):
        scene.video(tmp_path / "film.mp4", size=(641, 360))
    with pytest.raises(tx.InputError, match="no folder"):
        scene.video(tmp_path / "none" / "film.mp4")
    monkeypatch.setitem(__import__("sys").modules, "imageio_ffmpeg", None)
    with pytest.raises(tx.ModelError, match=r"pip install 'twistax\[video\]'"):
        scene.video(tmp_path / "film.mp4")
    monkeypatch.setitem(__import__("sys").modules, "imageio_ffmpeg", object())
    monkeypatch.setattr(shutil, "which", lambda name: None)
    with pytest.raises(tx.ModelError, match="Chromium"):
        scene.video(tmp_path / "film.mp4")


@pytest.mark.slow
@pytest.mark.skipif(not (shutil.which("chromium") or shutil.which("google-chrome")), reason="no Chromium is installed")
@pytest.mark.skipif(importlib.util.find_spec("imageio_ffmpeg") is None, reason="imageio-ffmpeg is not installed")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
# The browser ends with its connections open, which viser's server says in a thread of its own.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_film_shows_the_motion(tmp_path: Path) -> None:
    import imageio_ffmpeg

    path = moving(seconds=0.2).video(tmp_path / "film.mp4", size=(320, 240))
    frames = imageio_ffmpeg.read_frames(path)
    assert next(frames)["size"] == (320, 240)
    pictures = [np.frombuffer(frame, np.uint8) for frame in frames]
    assert len(pictures) == 7
    assert np.abs(pictures[0].astype(int) - pictures[-1]).max() > 50
