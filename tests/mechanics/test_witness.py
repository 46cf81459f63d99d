"""Witness points, cylinders, and solids around meshes: closed forms, Coal, SciPy, derivatives by differences."""

import functools
from typing import Any

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_distances import SHAPES, poses, values

import twistax as tx
from twistax.errors import InputError, ModelError
from twistax.mechanics import (
    ConvexPolytope,
    DistanceGrid,
    HalfSpace,
    clearances,
    fitted_capsule,
    fitted_spheres,
    signed_distance,
    witness_points,
)
from twistax.view import Capsule, Cylinder, Mesh, Sphere

RADIUS, LENGTH = 0.35, 0.8
SOLIDS: dict[str, Any] = {**SHAPES, "cylinder": Cylinder(RADIUS, LENGTH)}
PAIRS = [("sphere", "box"), ("capsule", "capsule"), ("capsule", "cylinder"), ("half", "cylinder"), ("capsule", "half")]


def coal_solids(coal: Any) -> dict[str, Any]:
    return {
        "sphere": coal.Sphere(0.3),
        "capsule": coal.Capsule(0.2, 0.9),
        "box": coal.Box(0.4, 0.7, 1.1),
        "half": coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0),
        "cylinder": coal.Cylinder(RADIUS, LENGTH),
    }


def by_coal(pair: tuple[str, str], A: np.ndarray, B: np.ndarray) -> np.ndarray:
    """(count, 7) the distances and both nearest points."""
    coal = pytest.importorskip("coal", reason="coal is not installed (it comes with pin)")
    (one, two), rows = (coal_solids(coal)[name] for name in pair), []
    request = coal.DistanceRequest(True)
    request.gjk_tolerance = request.epa_tolerance = 1e-10
    for places in zip(A, B, strict=True):
        result = coal.DistanceResult()
        first, second = (coal.Transform3s(T[:3, :3], T[:3, 3]) for T in places)
        d = coal.distance(one, first, two, second, request, result)
        rows.append([d, *result.getNearestPoint1(), *result.getNearestPoint2()])
    return np.array(rows)


@functools.cache
def lowered(pair: tuple[str, str]) -> Any:
    near = witness_points(SOLIDS[pair[0]], SOLIDS[pair[1]], tx.State("A", (4, 4)), tx.State("B", (4, 4)))
    found = tx.lower({"a": near.on_a, "b": near.on_b, "n": near.normal, "d": near.distance})
    return jax.jit(jax.vmap(lambda A, B: found(0.0, {"A": A, "B": B})))


@pytest.mark.parametrize("pair", PAIRS, ids="-".join)
def test_witness_points_as_coal_has_them(pair: tuple[str, str]) -> None:
    A, B = poses(200, 1.2)
    expected, found = by_coal(pair, A, B), lowered(pair)(A, B)
    a, b, n, d = (np.asarray(found[name]) for name in "abnd")
    np.testing.assert_allclose(b - a, d[:, None] * n, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(n, axis=1), 1.0, atol=1e-12)
    apart = expected[:, 0] > 1e-3
    assert apart.sum() > 50
    assert np.abs(d - expected[:, 0])[apart].max() < 1e-6
    off = np.abs(np.hstack([a, b]) - expected[:, 1:])[apart].max(axis=1)
    assert np.quantile(off, 0.95) < 3e-5  # Coal iterates for a cylinder, to 1e-10 of the distance


def beyond(name: str, p: np.ndarray) -> np.ndarray:
    """The signed distances (k,) of points (k, 3) in the frame of a box, a capsule or a cylinder."""
    if name == "capsule":
        return np.linalg.norm(p - np.clip(p, [0.0, 0.0, -0.45], [0.0, 0.0, 0.45]), axis=1) - 0.2
    away = np.abs(p) - [0.2, 0.35, 0.55]
    if name == "cylinder":
        away = np.stack([np.hypot(p[:, 0], p[:, 1]) - RADIUS, np.abs(p[:, 2]) - 0.5 * LENGTH], axis=1)
    return np.linalg.norm(np.maximum(away, 0.0), axis=1) + np.minimum(away.max(axis=1), 0.0)


def quarter_turns() -> np.ndarray:
    """(200, 4, 4) poses at which edges, faces and axes are parallel: apart, touching and overlapping."""
    rng, T = np.random.default_rng(8), np.tile(np.eye(4), (200, 1, 1))
    angles = rng.integers(0, 4, size=(200, 3))
    T[:, :3, :3] = np.round(Rotation.from_euler("xyz", 90.0 * angles, degrees=True).as_matrix())
    T[:, :3, 3] = rng.choice([-0.8, -0.45, -0.2, 0.0, 0.1, 0.55, 0.9], size=(200, 3))
    return T


@pytest.mark.parametrize(
    "pair",
    [
        ("capsule", "cylinder"),
        pytest.param(("box", "box"), marks=pytest.mark.thorough),
        pytest.param(("box", "cylinder"), marks=pytest.mark.thorough),
    ],
    ids="-".join,
)
def test_points_of_parallel_faces_are_on_both_solids(pair: tuple[str, str]) -> None:
    A, B = np.tile(np.eye(4), (200, 1, 1)), quarter_turns()
    near = lowered(pair)(A, B)
    d = np.asarray(near["d"])
    assert min((d < -0.1).sum(), (d > 0.1).sum()) > 10
    for name, T, key in zip(pair, (A, B), "ab", strict=True):
        p = np.einsum("kji,kj->ki", T[:, :3, :3], np.asarray(near[key]) - T[:, :3, 3])
        assert np.abs(beyond(name, p)).max() < 1e-9


def test_of_overlapping_solids_the_normal_separates() -> None:
    A, B = poses(100, 0.5)
    found = lowered(("box", "box"))(A, B)
    inside = np.asarray(found["d"]) < -1e-2
    assert inside.sum() > 40
    moved = B.copy()
    moved[:, :3, 3] -= np.asarray(found["d"])[:, None] * np.asarray(found["n"])
    assert np.abs(np.asarray(lowered(("box", "box"))(A, moved)["d"]))[inside].max() < 1e-10


def test_derivatives_of_witness_points() -> None:
    T_a, xi = tx.State("A", (4, 4)), tx.State("xi", (6,))
    near = witness_points(SOLIDS["capsule"], SOLIDS["cylinder"], tx.lie.Compose(T_a, tx.lie.SE3Exp(xi)))
    f = tx.lower(tx.Concat(near.on_a, near.on_b, near.normal))
    A = poses(30, 1.5)[0]
    A = A[np.asarray(lowered(("capsule", "cylinder"))(A, np.tile(np.eye(4), (len(A), 1, 1)))["d"]) > 0.05]
    at = jax.jit(jax.vmap(lambda x, A: f(0.0, {"xi": x, "A": A})))
    slopes = jax.jit(jax.vmap(jax.jacrev(lambda x, A: f(0.0, {"xi": x, "A": A}))))
    x, h = np.full((len(A), 6), 1e-2), 1e-5
    first = np.stack([(at(x + h * e, A) - at(x - h * e, A)) / (2.0 * h) for e in np.eye(6)[:, None]], axis=2)
    off = np.abs(first - slopes(x, A)).max(axis=(1, 2)) / (1.0 + np.abs(first).max(axis=(1, 2)))
    assert len(A) > 12
    assert np.quantile(off, 0.9) < 1e-6


def test_a_point_beside_a_cylinder() -> None:
    A, B = poses(300, 0.6)
    p = np.einsum("kji,kj->ki", A[:, :3, :3], B[:, :3, 3] - A[:, :3, 3])
    across, up = np.hypot(p[:, 0], p[:, 1]) - RADIUS, np.abs(p[:, 2]) - 0.5 * LENGTH
    expected = np.hypot(np.maximum(across, 0.0), np.maximum(up, 0.0)) + np.minimum(np.maximum(across, up), 0.0) - 0.3
    assert np.abs(values(SOLIDS["cylinder"], SOLIDS["sphere"], A, B) - expected).max() < 1e-12
    assert (across < 0.0).any()
    assert (up < 0.0).any()


def test_an_upright_capsule_in_a_lying_cylinder() -> None:
    """Both ends of the segment are on one line through the axis."""
    A, B = np.tile(np.eye(4), (200, 1, 1)), np.tile(np.eye(4), (200, 1, 1))
    B[:, :3, :3] = [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]
    B[:, 2, 3] = np.linspace(0.46, 1.2, 200)
    expected = B[:, 2, 3] - 0.45 - 0.2 - RADIUS
    np.testing.assert_allclose(lowered(("capsule", "cylinder"))(A, B)["d"], expected, atol=1e-12)


def test_a_cylinder_over_a_plane() -> None:
    A, B = poses(50, 1.0)
    T = np.linalg.inv(B) @ A
    angles = np.linspace(0.0, 2.0 * np.pi, 100_001)
    ring = RADIUS * (T[:, 2, :1] * np.cos(angles) + T[:, 2, 1:2] * np.sin(angles))
    expected = T[:, 2, 3] + ring.min(axis=1) - 0.5 * LENGTH * np.abs(T[:, 2, 2])
    assert np.abs(values(SOLIDS["cylinder"], HalfSpace(), A, B) - expected).max() < 1e-9
    upright = tx.lower(signed_distance(SOLIDS["cylinder"], HalfSpace(), tx.pose(position=[0.0, 0.0, 1.0])))
    assert float(upright(0.0, {})) == pytest.approx(0.6, abs=1e-15)


@functools.cache
def cloud() -> np.ndarray:
    rng = np.random.default_rng(2)
    return np.asarray(rng.normal(size=(60, 3)) * [0.05, 0.08, 0.3] @ np.linalg.qr(rng.normal(size=(3, 3)))[0] + 1.0)


def inside(count: int) -> np.ndarray:
    weights = np.random.default_rng(3).dirichlet(np.full(len(cloud()), 0.1), size=count)
    return np.concatenate([cloud(), weights @ cloud()])


def test_a_fitted_capsule_contains_the_mesh_and_is_tight() -> None:
    capsule = fitted_capsule(cloud())
    local = (inside(500) - capsule.at[:3, 3]) @ capsule.at[:3, :3]
    local[:, 2] -= np.clip(local[:, 2], -0.5 * capsule.length, 0.5 * capsule.length)
    away = np.linalg.norm(local, axis=1)
    assert away.max() <= capsule.radius + 1e-9
    assert capsule.radius - away.max() < 1e-6
    rod = fitted_capsule(Mesh((Capsule(0.1, 0.6).mesh()), at=(0.3, 0.0, 0.0)))
    np.testing.assert_allclose([rod.radius, rod.length], [0.1, 0.6], rtol=2e-2)


@pytest.mark.parametrize("count", [1, 4])
def test_fitted_spheres_contain_the_hull(count: int) -> None:
    spheres = fitted_spheres(ConvexPolytope(cloud()), count)
    assert len(spheres) == count
    away = [np.linalg.norm(inside(2000) - ball.at[:3, 3], axis=1) - ball.radius for ball in spheres]
    assert np.min(away, axis=0).max() < 1e-9
    volume = sum(ball.radius**3 for ball in spheres)
    assert count == 1 or volume < 0.5 * fitted_spheres(cloud(), 1)[0].radius ** 3


def test_fitted_spheres_of_many_corners_stay_small() -> None:
    points = np.random.default_rng(4).normal(size=(400, 3))
    corners = points / np.linalg.norm(points, axis=1)[:, None] * [1.0, 0.3, 0.2]
    spheres = fitted_spheres(corners, 5)
    away = [np.linalg.norm(corners - ball.at[:3, 3], axis=1) - ball.radius for ball in spheres]
    assert np.min(away, axis=0).max() < 1e-9


@pytest.mark.parametrize("pair", [("sphere", "box"), ("box", "box")])
def test_solids_with_one_centre_have_no_nan(pair: tuple[str, str]) -> None:
    same = np.tile(np.eye(4), (100, 1, 1))
    near = lowered(pair)(same, same)
    assert all(np.isfinite(np.asarray(value)).all() for value in near.values())
    if pair == ("box", "box"):
        np.testing.assert_allclose(np.linalg.norm(np.asarray(near["n"]), axis=1), 1.0)


def test_clearances_of_links_with_cylinders() -> None:
    arm = tx.mechanics.chain_models.equal_links(3)
    pairs = clearances(arm, {"joint0": Cylinder(0.05, 0.3), "joint2": Sphere(0.05)}, far=0.5)
    assert list(pairs) == ["joint0-joint2"]
    assert np.isfinite(float(tx.lower(pairs["joint0-joint2"])(0.0, {"q": np.zeros(3)})))


def test_what_is_refused(unchecked: None) -> None:
    grid = DistanceGrid([np.linspace(-1.0, 1.0, 5)] * 3, np.zeros((5, 5, 5)))
    with pytest.raises(ModelError, match="expects a Sphere as the partner of a DistanceGrid, got Cylinder"):
        witness_points(grid, Cylinder(0.1, 0.2))
    with pytest.raises(InputError, match="span a volume"):
        fitted_capsule(np.zeros((5, 3)))
    with pytest.raises(ModelError, match="count"):
        fitted_spheres(cloud(), 0)
