"""Signed distances of solids: closed forms, bounded least squares, Coal, and their derivatives by differences."""

import itertools
from typing import Any

import jax
import numpy as np
import pytest
from mechanics_oracles import pose
from scipy.optimize import lsq_linear

import twistax as tx
from twistax import mechanics
from twistax.errors import ModelError, ShapeError
from twistax.mechanics import HalfSpace, signed_distance
from twistax.view import Box, Capsule, Cone, Sphere

SHAPES: dict[str, Any] = {
    "sphere": Sphere(0.3),
    "capsule": Capsule(0.2, 0.9),
    "box": Box((0.4, 0.7, 1.1)),
    "half": HalfSpace(),
}
PAIRS = [pair for pair in itertools.combinations_with_replacement(SHAPES, 2) if pair != ("half", "half")]


def poses(count: int, spread: float) -> np.ndarray:
    rng = np.random.default_rng(0)
    T = np.stack([pose(rng) for _ in range(2 * count)])
    T[:, :3, 3] *= spread
    return T.reshape(2, count, 4, 4)


def values(a: Any, b: Any, A: np.ndarray, B: np.ndarray) -> np.ndarray:
    distance = tx.lower(signed_distance(a, b, tx.State("A", (4, 4)), tx.State("B", (4, 4))))
    return np.asarray(jax.jit(jax.vmap(lambda A, B: distance(0.0, {"A": A, "B": B})))(A, B))


def by_least_squares(half: list[Any], radius: float, A: np.ndarray, B: np.ndarray) -> float:
    """The distance of two cores by active sets, exact to rounding, less the radii."""
    within = np.concatenate(half)
    T = np.linalg.inv(A) @ B
    move = within > 0.0
    columns = np.hstack([np.eye(3), -T[:3, :3]])[:, move]
    if not move.any():
        return float(np.linalg.norm(T[:3, 3])) - radius
    fit = lsq_linear(columns, T[:3, 3], (-within[move], within[move]), method="bvls", tol=1e-15)
    return float(np.linalg.norm(fit.fun)) - radius


@pytest.mark.parametrize("pair", [pair for pair in PAIRS if "half" not in pair], ids="-".join)
def test_apart_as_bounded_least_squares_has_it(pair: tuple[str, str]) -> None:
    half = {"sphere": np.zeros(3), "capsule": np.array([0.0, 0.0, 0.45]), "box": np.array([0.2, 0.35, 0.55])}
    radius = {"sphere": 0.3, "capsule": 0.2, "box": 0.0}
    A, B = poses(60, 1.5)
    distances = values(SHAPES[pair[0]], SHAPES[pair[1]], A, B)
    taken = [half[name] for name in pair], sum(radius[name] for name in pair)
    expected = np.array([by_least_squares(*taken, *both) for both in zip(A, B, strict=True)])
    apart = expected > -taken[1] + 1e-6
    assert apart.sum() > 40
    assert np.abs(distances - expected)[apart].max() < 1e-12


def test_heights_over_a_plane() -> None:
    A, B = poses(50, 1.0)
    corners = np.array(list(itertools.product((-0.2, 0.2), (-0.35, 0.35), (-0.55, 0.55))))
    ends = np.array([[0.0, 0.0, -0.45], [0.0, 0.0, 0.45]])
    for name, points, radius in (("box", corners, 0.0), ("capsule", ends, 0.2), ("sphere", np.zeros((1, 3)), 0.3)):
        T = np.linalg.inv(B) @ A
        heights = (points @ np.swapaxes(T[:, :3, :3], 1, 2) + T[:, None, :3, 3])[:, :, 2].min(axis=1) - radius
        assert np.abs(values(SHAPES[name], SHAPES["half"], A, B) - heights).max() < 1e-12
        assert np.abs(values(SHAPES["half"], SHAPES[name], B, A) - heights).max() < 1e-12


@pytest.mark.parametrize("pair", PAIRS, ids="-".join)
def test_as_coal_has_it(pair: tuple[str, str]) -> None:
    coal = pytest.importorskip("coal", reason="coal is not installed (it comes with pin)")
    solids = {
        "sphere": coal.Sphere(0.3),
        "capsule": coal.Capsule(0.2, 0.9),
        "box": coal.Box(0.4, 0.7, 1.1),
        "half": coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0),
    }
    A, B = poses(500, 0.7)

    def theirs(A: np.ndarray, B: np.ndarray) -> float:
        places = (coal.Transform3s(T[:3, :3], T[:3, 3]) for T in (A, B))
        (one, two), request = (solids[name] for name in pair), coal.DistanceRequest(True)
        first, second = places
        return float(coal.distance(one, first, two, second, request, coal.DistanceResult()))

    expected = np.array([theirs(*both) for both in zip(A, B, strict=True)])
    assert (expected < -1e-3).sum() > 10
    # Coal iterates where there is a box, to a tolerance that other tests may have set.
    off = np.abs(values(SHAPES[pair[0]], SHAPES[pair[1]], A, B) - expected)
    assert off.max() < (2e-6 if pair == ("box", "box") else 1e-9)


def test_boxes_overlap_by_the_least_depth_of_the_separating_axes() -> None:
    """Ericson, Real-Time Collision Detection (2005), section 4.4.1: normals of faces, and products of edges."""
    A, B = poses(500, 0.7)
    half, depths = np.array([0.2, 0.35, 0.55]), []
    for one, two in zip(A[:, :3], B[:, :3], strict=True):
        (R, p), (Q, q) = (one[:, :3], one[:, 3]), (two[:, :3], two[:, 3])
        axes = np.concatenate([R.T, Q.T, np.cross(R.T[:, None], Q.T[None]).reshape(-1, 3)])
        axes = axes[np.linalg.norm(axes, axis=1) > 1e-6]
        axes /= np.linalg.norm(axes, axis=1)[:, None]
        depths.append((np.abs(axes @ (q - p)) - (np.abs(axes @ R) + np.abs(axes @ Q)) @ half).max())
    overlap = np.array(depths) < 0.0
    assert overlap.sum() > 40
    distances = values(SHAPES["box"], SHAPES["box"], A, B)
    assert np.abs(distances - depths)[overlap].max() < 1e-12


@pytest.mark.parametrize(
    "pair", [("sphere", "box"), ("capsule", "capsule"), ("capsule", "box"), ("box", "half")], ids="-".join
)
def test_first_and_second_derivatives(pair: tuple[str, str]) -> None:
    xi, T_a, T_b = tx.State("xi", (6,)), tx.State("A", (4, 4)), tx.State("B", (4, 4))
    moved = tx.lie.Compose(T_a, tx.lie.SE3Exp(xi))
    lowered = tx.lower(signed_distance(SHAPES[pair[0]], SHAPES[pair[1]], moved, T_b))
    A, B = poses(40, 0.8)
    gradient = jax.grad(lambda x, A, B: lowered(0.0, {"xi": x, "A": A, "B": B}))
    f, g, H = (
        jax.jit(jax.vmap(function))
        for function in (lambda x, A, B: lowered(0.0, {"xi": x, "A": A, "B": B}), gradient, jax.jacfwd(gradient))
    )
    x, h = np.random.default_rng(1).normal(size=(40, 6)) * 1e-2, 1e-5
    slopes, curves, first, second = np.asarray(g(x, A, B)), np.asarray(H(x, A, B)), [], []
    for unit in np.eye(6)[:, None]:
        first.append((f(x + h * unit, A, B) - f(x - h * unit, A, B)) / (2.0 * h))
        second.append((g(x + h * unit, A, B) - g(x - h * unit, A, B)) / (2.0 * h))
    off = np.abs(np.stack(first, axis=1) - slopes).max(axis=1)
    off_second = np.abs(np.stack(second, axis=1) - curves).max(axis=(1, 2)) / (1.0 + np.abs(curves).max(axis=(1, 2)))
    # All but those next to a change of features.
    assert np.mean(off < 1e-6) > 0.95
    assert np.mean(off_second < 1e-6) > 0.95
    assert np.abs(slopes).max() > 0.5


def test_parallel_capsules_and_boxes() -> None:
    def along(x, z):
        return tx.pose(position=[x, 0.0, z])

    capsule, box = Capsule(0.1, 1.0), Box((1.0, 1.0, 1.0))
    apart = [(capsule, along(0.5, 0.3), 0.3), (capsule, along(0.5, 2.0), np.hypot(0.5, 1.0) - 0.2)]
    for shape, T, expected in apart:
        assert np.isclose(float(tx.lower(signed_distance(capsule, shape, None, T))(0.0, {})), expected, atol=1e-14)
    for T, expected in ((along(1.5, 0.2), 0.5), (along(1.3, 1.4), 0.5), (along(0.8, 0.1), -0.2)):
        assert np.isclose(float(tx.lower(signed_distance(box, box, None, T))(0.0, {})), expected, atol=1e-14)


def test_places_of_shapes_count() -> None:
    ball, at = Sphere(0.1, at=(1.0, 2.0, 3.0)), tx.pose(position=[0.0, 0.0, 1.0])
    ground = HalfSpace(at=tx.pose(position=[0.0, 0.0, 0.5]))
    assert np.isclose(float(tx.lower(signed_distance(ball, ground, at))(0.0, {})), 4.0 - 0.5 - 0.1)


def test_a_robot_keeps_clear() -> None:
    arm = mechanics.chain_models.equal_links(2)
    lying = np.array([[0.0, 0.0, 1.0, 0.1], [0.0, 1.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    hand = Capsule(0.05, 0.2, at=lying)  # along x
    clear = signed_distance(hand, Sphere(0.1, at=(0.5, 0.0, 0.0)), arm.pose("joint1"))
    system = arm.system(outputs={"clear": clear}, constraints={"clear": clear >= 0.02})
    x = {"q": np.zeros(2), "qd": np.zeros(2)}
    assert np.isclose(tx.compile(system).outputs(0.0, x, {"tau": np.zeros(2)})["clear"], -0.05)  # from 0.4 to 0.5 m


def test_what_has_no_distance(unchecked: None) -> None:
    with pytest.raises(ModelError, match="Sphere, Capsule, Box or Cylinder"):
        signed_distance(Cone(1.0, 0.3), Sphere(0.1))
    with pytest.raises(ModelError, match="at most one HalfSpace, got two"):
        signed_distance(HalfSpace(), HalfSpace())
    with pytest.raises(ModelError, match="T_a to be a pose"):
        signed_distance(Sphere(0.1), HalfSpace(), np.diag([1.0, 1.0, -1.0, 1.0]))
    with pytest.raises(ShapeError, match="T_b with shape"):
        signed_distance(Sphere(0.1), HalfSpace(), None, np.eye(3))
    with pytest.raises(ModelError, match="HalfSpace expects at to be a pose"):
        HalfSpace(at=2.0 * np.eye(4))
