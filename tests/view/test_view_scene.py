"""Scenes as numbers: where bodies are, which way arrows point, when; and what is refused."""

import dataclasses
import functools
import importlib.util
import threading
import time
import urllib.request
import webbrowser
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import twistax as tx
from solutions import scene_of, solution_of
from twistax.mechanics import Chain, Link, SpatialInertia, joints

TIMES = np.array([0.0, 0.5, 1.0, 2.0])
AXIS = np.array([1.0, 2.0, 2.0]) / 3.0


def turned(t: np.ndarray) -> Rotation:
    """A turn by 1.3 rad/s about a fixed axis, from an attitude with three angles."""
    return Rotation.from_rotvec(1.3 * np.multiply.outer(t, AXIS)) * Rotation.from_euler("xyz", [0.3, -0.4, 0.5])


def poses(t: np.ndarray) -> np.ndarray:
    T = np.tile(np.eye(4), (len(t), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = turned(t).as_matrix(), np.stack([3.0 * t, -t, 2.0 + 0.0 * t], axis=1)
    return T


F = np.stack([TIMES, 1.0 + TIMES, 0.0 * TIMES, 0.0 * TIMES, 0.0 * TIMES, 2.0 - TIMES], axis=1)


def scene(**choices) -> tx.view.Scene:
    outputs = {"F": F, "f": F[:, :3]}
    return scene_of(TIMES, {"g": poses(TIMES), "m": TIMES}, outputs=lambda: outputs, **choices)


@pytest.fixture(autouse=True)
def _no_browser(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("twistax.view.motion._in_notebook", lambda: True)
    monkeypatch.setattr(webbrowser, "open", lambda *_: pytest.fail("a browser was opened"))


def test_pictures_between_saved_times_are_on_the_motion() -> None:
    """Of a turn about one axis and a straight line, which are what is interpolated, they are exact."""
    found = scene().frames()
    np.testing.assert_allclose(np.diff(found.ts), 1.0 / 30.0)
    assert found.ts[[0, -1]].tolist() == [0.0, 2.0]
    (body,) = found.bodies
    np.testing.assert_allclose(body.poses, poses(found.ts), atol=1e-12)


def test_arrows_turn_with_their_body_or_do_not() -> None:
    at = np.array([0.0, 0.1, -0.5])
    inside, outside = (
        scene(arrows={"F": tx.view.Arrow("g", at=at, world=world, scale=0.5)}).at(np.array([0.25, 1.5])).vectors
        for world in (False, True)
    )
    t = np.array([0.25, 1.5])
    start = poses(t)[:, :3, 3] + turned(t).apply(at)
    force = np.stack([t, 1.0 + t, 0.0 * t], axis=1)
    torque = np.stack([0.0 * t, 0.0 * t, 2.0 - t], axis=1)
    for vector, value in zip(inside, (force, torque)):
        np.testing.assert_allclose(vector.ends(0.5)[:, 0], start, atol=1e-12)
        np.testing.assert_allclose(vector.ends(0.5)[:, 1], start + 0.5 * turned(t).apply(value), atol=1e-12)
    np.testing.assert_allclose(outside[0].ends(-2.0)[:, 1], start - 2.0 * force, atol=1e-12)
    plain = scene(arrows={"f": tx.view.Arrow()})
    longest = np.linalg.norm(np.diff(plain.vectors[0].ends(plain.scale_of(plain.vectors[0])), axis=1), axis=2).max()
    assert longest == pytest.approx(0.2 * plain.size)


def test_an_ellipsoid_has_the_inertia_it_is_made_of() -> None:
    """Of a box by its formula: mass and moments are those of the solid ellipsoid's corners, put together again."""
    R = Rotation.from_euler("xyz", [0.3, 0.9, -0.4]).as_matrix()
    a, b, c = radii = np.array([0.5, 0.3, 0.2])
    inertia = R @ np.diag([b * b + c * c, a * a + c * c, a * a + b * b]) @ R.T * 7.0 / 5.0
    found = tx.view.Ellipsoid.of_inertia(7.0, (1.0, 2.0, 3.0), inertia)
    np.testing.assert_allclose(np.sort(found.radii), np.sort(radii))
    shape = (found.at[:3, :3] * found.radii**2) @ found.at[:3, :3].T
    np.testing.assert_allclose(shape, (R * radii**2) @ R.T, atol=1e-12)
    assert np.linalg.det(found.at[:3, :3]) == pytest.approx(1.0)
    np.testing.assert_array_equal(found.at[:3, 3], [1.0, 2.0, 3.0])


SOLIDS = {
    "box": (tx.view.Box((1.0, 2.0, 3.0)), 6.0),
    "ball": (tx.view.Sphere(2.0), 4.0 / 3.0 * np.pi * 8.0),
    "ellipsoid": (tx.view.Ellipsoid((1.0, 2.0, 3.0)), 8.0 * np.pi),
    "cylinder": (tx.view.Cylinder(2.0, 3.0), 12.0 * np.pi),
    "capsule": (tx.view.Capsule(2.0, 3.0), 12.0 * np.pi + 4.0 / 3.0 * np.pi * 8.0),
}


@pytest.mark.parametrize("name", SOLIDS)
def test_triangles_close_and_face_outwards(name: str) -> None:
    """By the volume that they enclose, which is negative where they face inwards."""
    solid, volume = SOLIDS[name]
    corners, faces = solid.mesh()
    a, b, c = np.moveaxis(corners[faces], 1, 0)
    assert np.sum(a * np.cross(b, c)) / 6.0 == pytest.approx(volume, rel=0.03)


def test_a_cone_opens_upwards_by_its_angle() -> None:
    corners, _ = tx.view.Cone(3.0, 0.4).mesh()
    rim = corners[corners[:, 2] > 0.0]
    np.testing.assert_allclose(np.hypot(rim[:, 0], rim[:, 1]), 3.0 * np.tan(0.4))


@functools.cache
def arm() -> Chain:
    body = SpatialInertia(mass=2.0, center_of_mass=[0.5, 0.0, 0.0], inertia=np.diag([0.01, 0.2, 0.2]))
    out = np.eye(4)
    out[0, 3] = 1.0
    return Chain(
        [
            Link(joints.Revolute("a", [0.0, 0.0, 1.0]), body, np.eye(4)),
            Link(joints.Revolute("b", [0.0, 0.0, 1.0]), None, out, shapes=(tx.view.Box((0.1, 0.1, 0.1)),)),
        ]
    )


def test_links_are_where_their_joints_put_them() -> None:
    q = np.stack([0.3 * TIMES, 0.5 - TIMES], axis=1)
    scene_of_arm = scene_of(TIMES, {"q": q, "qd": 0.0 * q}, bodies=arm(), trails=["b"])
    found = {body.name: body for body in scene_of_arm.bodies}
    assert list(found) == ["base", "a", "b"]
    np.testing.assert_allclose(found["b"].poses[:, :3, 3].T, [np.cos(q[:, 0]), np.sin(q[:, 0]), 0.0 * TIMES], atol=1e-6)
    turn = Rotation.from_rotvec(np.multiply.outer(q.sum(axis=1), [0.0, 0.0, 1.0])).as_matrix()
    np.testing.assert_allclose(found["b"].poses[:, :3, :3], turn, atol=1e-6)
    assert [type(s) for s in found["a"].shapes] == [tx.view.Ellipsoid]
    assert [type(s) for s in found["b"].shapes] == [tx.view.Box]
    assert {name: body.trail for name, body in found.items()} == {"base": False, "a": False, "b": True}
    with pytest.raises(tx.InputError, match="the state 'q'"):
        scene(bodies=arm())


def test_a_solution_shows_itself() -> None:
    """Rows that were not reached, NaN, are left out."""
    T = poses(TIMES)
    T[-1] = np.nan
    solution = solution_of(TIMES, {"g": T, "R": T[:, :3, :3], "p": T[:, :3, 3]})
    assert [body.name for body in solution.show().bodies] == ["g", "R"]
    (pair,) = solution.show(bodies={("R", "p"): tx.view.Sphere(0.1)}).bodies
    np.testing.assert_allclose(pair.poses, poses(TIMES[:3]), atol=1e-12)
    with pytest.raises(tx.InputError, match="a batch"):
        jax.tree.map(lambda a: a[None], solution).show()
    with pytest.raises(tx.InputError, match="save_at"):
        jax.tree.map(lambda a: a[:1], solution).show(bodies={"g": ()})


def test_phases_are_shown_one_after_the_other() -> None:
    """What all of them have; of a join what comes after the jump."""
    ts = (TIMES[:3], TIMES[2:])
    later = poses(TIMES[2:])
    later[:, 2, 3] += 5.0
    xs = ({"g": jnp.asarray(poses(ts[0]))}, {"g": jnp.asarray(later), "m": jnp.ones(2)})
    parts = tuple(solution_of(t, x) for t, x in zip(ts, xs))
    begins, saved = (jnp.zeros(()), jnp.ones(())), jnp.asarray(TIMES)
    flight = tx.PhasedSolution(parts, ({}, {}), begins, np.zeros(()), saved, ("a", "b"), False)
    scene = flight.show(trails=[], axes=["g"])
    (body,) = scene.bodies
    np.testing.assert_array_equal(scene.ts, TIMES)
    np.testing.assert_allclose(body.poses[:, 2, 3], [2.0, 2.0, 7.0, 7.0])
    assert (body.trail, body.axes) == (False, True)
    with pytest.raises(tx.InputError, match="expects saved times"):
        dataclasses.replace(flight, save_at=None).show()


def test_without_viser_it_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "viser", None)
    with pytest.raises(tx.ModelError, match=r"pip install 'twistax\[view\]'"):
        scene(path=tmp_path / "scene.html")


@pytest.mark.skipif(importlib.util.find_spec("viser") is None, reason="viser is not installed")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_page_has_everything_in_it(tmp_path: Path) -> None:
    file = tmp_path / "scene.html"
    scene(path=file, arrows={"F": tx.view.Arrow()}, shapes=[tx.view.Cone(2.0, 0.5)], up=(0.0, 0.0, -1.0))
    text = file.read_text()
    assert len(text) < 2_000_000
    assert 'src="http' not in text
    assert "__VISER_EMBED_DATA__" in text
    with pytest.raises(tx.InputError, match="cannot write"):
        scene(path=tmp_path / "no" / "scene.html")


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("viser") is None, reason="viser is not installed")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_live_scene_is_served_until_it_is_stopped() -> None:
    """Its slider goes on by itself, and nothing is left behind."""
    before = threading.active_count()
    server = scene(arrows={"F": tx.view.Arrow()}).live(port=18080)
    address = f"http://127.0.0.1:{server.get_port()}"
    with urllib.request.urlopen(address, timeout=10) as page:
        assert page.status == 200
    time.sleep(0.5)
    server.stop()
    time.sleep(0.5)
    assert threading.active_count() <= before + 1
    with pytest.raises(OSError, match="refused"):
        urllib.request.urlopen(address, timeout=10)
