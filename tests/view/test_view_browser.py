"""A page in a real browser, without a network: it loads, says no error, and its picture is not empty."""

import importlib.util
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import twistax as tx
from solutions import scene_of

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed"),
    pytest.mark.skipif(importlib.util.find_spec("viser") is None, reason="viser is not installed"),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
]


PENDULUM = """
<robot name="pendulum"><link name="wall"/><link name="rod">
  <inertial><origin xyz="0 0 -0.5"/><mass value="1"/><inertia ixx="0.1" iyy="0.1" izz="0.01"/></inertial>
  <visual><origin xyz="0 0 -0.5"/><geometry><cylinder radius="0.1" length="1"/></geometry>
    <material name="red"><color rgba="0.9 0.1 0.1 1"/></material></visual>
</link><joint name="hinge" type="continuous"><parent link="wall"/><child link="rod"/><axis xyz="0 1 0"/></joint></robot>
"""


def picture(page: Path, milliseconds: int, tries: int = 4) -> tuple[np.ndarray, str]:
    """The page after so much time, and what its console says.

    Chromium's own time may run out before its processes have loaded the page, and once in 24 runs it did not
    end on busy cores. Then it is started again.
    """
    from matplotlib.image import imread

    file = page.with_suffix(f".{milliseconds}.png")
    command = f"{CHROMIUM} --headless=new --no-sandbox --use-angle=swiftshader --enable-unsafe-swiftshader".split()
    command += [
        f"--user-data-dir={page.parent / f'profile-{milliseconds}-{tries}'}",
        "--host-resolver-rules=MAP * ~NOTFOUND",
    ]
    command += ["--window-size=800,600", "--enable-logging=stderr", f"--virtual-time-budget={milliseconds}"]
    command += [f"--screenshot={file}", page.as_uri()]
    try:
        said = subprocess.run(command, capture_output=True, text=True, timeout=60).stderr
    except subprocess.TimeoutExpired:
        said = ""
    console = "\n".join(line for line in said.splitlines() if "CONSOLE" in line)
    if tries > 1 and not (file.exists() and "Embedded data loaded" in console):
        return picture(page, milliseconds, tries - 1)
    return imread(file)[200:550, :, :3], console


def test_a_mechanism_of_a_file_is_drawn_in_a_browser(tmp_path: Path) -> None:
    """Its rod is red as the file says, the trail and the keep-out sphere are there, and nothing is said to be wrong."""
    path = tmp_path / "pendulum.urdf"
    path.write_text(PENDULUM)
    robot = tx.mechanics.load(path)
    t = np.linspace(0.0, 4.0, 41)
    xs = {"q": 2.0 * np.cos(t)[:, None], "qd": -2.0 * np.sin(t)[:, None]}
    page = tmp_path / "pendulum.html"
    shapes = [tx.view.Sphere(0.3, at=(0.0, 1.0, 0.0), color=(0, 160, 60))]
    scene_of(t, xs, page, bodies=robot, axes=["rod"], trails=["rod"], shapes=shapes)
    image, said = picture(page, 1500)
    assert not [line for line in said.splitlines() if "ERROR" in line or "rror:" in line]
    assert np.sum((image[..., 0] > 0.5) & (image[..., 1] < 0.35)) > 200
    assert np.sum((image[..., 1] > 1.3 * image[..., 0]) & (image[..., 1] > 1.3 * image[..., 2])) > 200


def test_a_scene_plays_in_a_browser(tmp_path: Path) -> None:
    t = np.linspace(0.0, 4.0, 41)
    poses = np.tile(np.eye(4), (41, 1, 1))
    poses[:, 0, 3] = 2.0 * t - 4.0
    page = tmp_path / "scene.html"
    red = tx.view.Box((2.0, 2.0, 2.0), color=(220, 30, 30))
    scene_of(t, {"g": poses}, page, bodies={"g": red}, shapes=[tx.view.Cone(3.0, 0.5, color=(0, 160, 60))])
    (early, said), (late, _) = picture(page, 800), picture(page, 3200)
    assert "Embedded data loaded" in said
    assert not [line for line in said.splitlines() if "ERROR" in line or "rror:" in line]
    red_at = [np.argwhere((image[..., 0] > 0.5) & (image[..., 1] < 0.35)) for image in (early, late)]
    assert min(map(len, red_at)) > 500  # the box
    assert abs(red_at[1][:, 1].mean() - red_at[0][:, 1].mean()) > 50  # and it moves
