"""Distances of convex polytopes, of many pairs and on grids: closed forms, Coal, derivatives by differences."""

import itertools
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from scipy.optimize import nnls
from test_distances import poses, values

import twistax as tx
from evaluated import evaluated
from twistax import mechanics
from twistax.errors import InputError, ModelError
from twistax.mechanics import (
    ConvexPolytope,
    DistanceGrid,
    HalfSpace,
    Link,
    Mechanism,
    clearances,
    joints,
    signed_distance,
    soft_minimum,
)
from twistax.view import Box, Capsule, Cylinder, Mesh, Sphere

EXAMPLES = Path(__file__).parents[2] / "examples"
POINTS = np.random.default_rng(5).normal(size=(2, 14, 3)) * 0.35
LENGTHS = (0.4, 0.7, 1.1)
CORNERS = np.array(list(itertools.product(*((-0.5 * h, 0.5 * h) for h in LENGTHS))))


@pytest.mark.parametrize("other", [Sphere(0.3), Capsule(0.2, 0.9), Box((0.5, 0.6, 0.3)), HalfSpace()], ids=str)
def test_a_box_as_a_polytope(other: Any) -> None:
    A, B = poses(60, 0.5)
    expected = values(Box(LENGTHS), other, A, B)
    assert np.abs(values(ConvexPolytope(CORNERS), other, A, B) - expected).max() < 1e-12
    assert np.abs(values(ConvexPolytope(CORNERS, radius=0.05), other, A, B) - expected + 0.05).max() < 1e-12
    assert (expected < -1e-2).sum() > 3


@pytest.mark.parametrize("other", ["polytope", "capsule"])
def test_as_coal_has_it(other: str) -> None:
    compare_with_coal(other, 200)


@pytest.mark.slow
def test_a_million_pairs_as_coal_has_them() -> None:
    compare_with_coal("polytope", 1_000_000)


def compare_with_coal(other: str, count: int) -> None:
    coal = pytest.importorskip("coal", reason="coal is not installed (it comes with pin)")
    from scipy.spatial import ConvexHull

    def solid(points: np.ndarray) -> Any:
        hull, corners, triangles = ConvexHull(points), coal.StdVec_Vec3s(), coal.StdVec_Triangle()
        for p in points:
            corners.append(p)
        for triangle, plane in zip(hull.simplices, hull.equations, strict=True):
            a, b, c = points[triangle]
            outward = np.dot(np.cross(b - a, c - a), plane[:3]) > 0.0
            triangles.append(coal.Triangle(*map(int, triangle if outward else triangle[::-1])))
        return coal.Convex(corners, triangles)

    first, second = (ConvexPolytope(points) for points in POINTS)
    ours = second if other == "polytope" else Capsule(0.2, 0.9)
    theirs = solid(second.corners) if other == "polytope" else coal.Capsule(0.2, 0.9)
    request, hull = coal.DistanceRequest(True), solid(first.corners)
    request.gjk_tolerance = request.epa_tolerance = 1e-10
    A, B = poses(count, 0.7)

    def theirs_at(P: np.ndarray, Q: np.ndarray) -> float:
        first, second = (coal.Transform3s(T[:3, :3], T[:3, 3]) for T in (P, Q))
        return float(coal.distance(hull, first, theirs, second, request, coal.DistanceResult()))

    expected = np.array([theirs_at(*both) for both in zip(A, B, strict=True)])
    distance = tx.lower(signed_distance(first, ours, tx.State("A", (4, 4)), tx.State("B", (4, 4))))
    every = jax.jit(jax.vmap(lambda A, B: distance(0.0, {"A": A, "B": B})))  # one for all parts
    parts = [every(*both) for both in zip(*(np.array_split(T, max(count // 1000, 1)) for T in (A, B)), strict=True)]
    assert np.abs(np.concatenate(parts) - expected).max() < 1e-6
    assert min((expected < -1e-2).sum(), (expected > 1e-2).sum()) > count // 20


def test_first_and_second_derivatives() -> None:
    first, second = (ConvexPolytope(points) for points in POINTS)
    xi, T_a, T_b = tx.State("xi", (6,)), tx.State("A", (4, 4)), tx.State("B", (4, 4))
    lowered = tx.lower(signed_distance(first, second, tx.lie.Compose(T_a, tx.lie.SE3Exp(xi)), T_b))
    A, B = poses(12, 0.8)
    value = lambda x, A, B: lowered(0.0, {"xi": x, "A": A, "B": B})  # noqa: E731
    f, g = (jax.jit(jax.vmap(function)) for function in (value, jax.grad(value)))
    H = jax.jit(jax.vmap(jax.jacfwd(jax.grad(value))))
    x, h = np.zeros((12, 6)), 1e-5
    slopes, curves = np.asarray(g(x, A, B)), np.asarray(H(x, A, B))
    units = np.eye(6)[:, None] * h
    by_values = np.stack([(f(x + u, A, B) - f(x - u, A, B)) / (2.0 * h) for u in units], axis=1)
    by_slopes = np.stack([(g(x + u, A, B) - g(x - u, A, B)) / (2.0 * h) for u in units], axis=1)
    near = np.abs(by_values - slopes).max(axis=1) < 1e-6
    assert near.mean() > 0.9  # all but next to a change of features
    assert (np.abs(by_slopes - curves).max(axis=(1, 2)) < 1e-6 * (1.0 + np.abs(curves).max(axis=(1, 2)))).mean() > 0.9
    assert np.abs(slopes).max() > 0.5


def test_a_hull_with_fewer_corners_contains_it() -> None:
    rng = np.random.default_rng(0)
    points = rng.normal(size=(200, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    small = ConvexPolytope(Mesh((points, np.array([[0, 1, 2]]))), most=20)
    assert len(small.corners) <= 20
    assert 0.05 < small.radius < 0.6
    inside = tx.lower(signed_distance(small, Sphere(1e-9), None, tx.State("T", (4, 4))))
    places = np.tile(np.eye(4), (200, 1, 1))
    places[:, :3, 3] = points
    assert np.asarray(jax.vmap(lambda T: inside(0.0, {"T": T}))(places)).max() < 1e-12
    weights = np.vstack([small.corners.T, np.full((1, len(small.corners)), 1e4)])  # not negative, with the sum 1
    away = [np.linalg.norm(small.corners.T @ nnls(weights, np.append(p, 1e4))[0] - p) for p in points]
    assert np.isclose(max(away), small.radius, rtol=1e-9)


def test_pairs_of_a_mechanism(tmp_path: Path) -> None:
    arm = mechanics.chain_models.equal_links(4)
    ball = Sphere(0.05)
    every = dict.fromkeys(("base", *(f"joint{i}" for i in range(4))), ball)
    pairs = clearances(arm, every, {"wall": Box((0.1, 1.0, 1.0), at=(2.0, 0.0, 0.0))})
    links = ["joint0-joint2", "joint0-joint3", "joint1-joint3", "base-joint1", "base-joint2", "base-joint3"]
    assert set(pairs) == {*links, *(f"joint{i}-wall" for i in range(4))}
    file = tmp_path / "arm.srdf"
    file.write_text(
        """<robot name="a"><disable_collisions link1="joint3" link2="joint0" reason="Never"/>
        <disable_collisions link1="joint3" link2="camera"/></robot>"""
    )
    left = clearances(arm, every, ignored=[("base", "joint1")], srdf=file)
    assert set(left) == {*links} - {"joint0-joint3", "base-joint1"}
    file.write_text('<robot name="a"><group name="all"/></robot>')
    assert set(clearances(arm, every, srdf=file)) == {*links}
    for text, message in (
        ('<disable_collisions link1="hand" link2="base"/>', "another robot: the mechanism has no frames 'hand'; it"),
        ('<link name="base"/>', "a URDF file"),
    ):
        file.write_text(f'<robot name="a">{text}</robot>')
        with pytest.raises(ModelError, match=message):
            clearances(arm, every, srdf=file)
    x = {"q": np.array([0.3, -0.7, 1.1, 0.4])}
    exact = evaluated(pairs, x)
    solids = dict.fromkeys(("base", "joint1", "joint2"), Box((0.2, 0.02, 0.02))) | {"joint3": Cylinder(0.02, 0.2)}
    straight = {"q": np.array([0.3, -0.1, 0.2, 0.1])}
    true, broad = (evaluated(clearances(arm, solids, far=far), straight) for far in (None, 0.1))
    is_near = {name: bool(abs(broad[name] - gap) < 1e-12) for name, gap in true.items()}
    assert all(broad[name] <= gap + 1e-12 for name, gap in true.items())
    assert all(near or 0.1 <= broad[name] < true[name] - 1e-3 for name, near in is_near.items())
    assert set(is_near.values()) == {True, False}
    least, soft = min(exact.values()), evaluated(soft_minimum(pairs, 0.02), x)
    assert least - 0.02 * np.log(len(pairs)) <= soft <= least
    assert soft < least - 1e-6


def test_pairs_with_one_name() -> None:
    """No pair is lost if names contain hyphens: "a-b" with "c", and "a" with "b-c"."""
    solids = {name: Sphere(0.1) for name in ("a", "a-b", "b-c", "c")}
    pairs = clearances(floating(solids), solids)
    x = {f"{name}_position": tx.pose(position=[at, 0.0, 0.0]) for name, at in zip(solids, (0.0, 5.0, 8.0, 9.0))}
    for far, at in ((4.0, 3.0), (8.0, 7.0)):
        x["c_position"] = tx.pose(position=[5.0 + far, 0.0, 0.0])
        x["b-c_position"] = tx.pose(position=[at, 0.0, 0.0])
        assert np.isclose(evaluated(pairs["a-b-c"], x), min(far, at) - 0.2)


def test_the_shapes_of_links_are_pairs() -> None:
    link = lambda name, x: Link(joints.Free(name), None, tx.pose(position=[x, 0.0, 0.0]), shapes=[Box((0.2, 0.2, 0.2))])  # noqa: E731
    pairs = clearances(Mechanism([link("a", 0.0), link("b", 1.0)]))
    assert list(pairs) == ["a-b"]
    x = {"a_position": np.eye(4), "b_position": np.eye(4)}
    assert np.isclose(float(evaluated(pairs["a-b"], x)), 0.8)


def test_a_grid_of_distances() -> None:
    axes = [np.linspace(-1.0, 1.0, 21)] * 3
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    table = np.linalg.norm(points, axis=-1) - 0.4  # of a ball
    at = tx.pose(position=[0.3, 0.0, 0.1])
    rng, T = np.random.default_rng(1), np.tile(np.eye(4), (100, 1, 1))
    T[:, :3, 3] = rng.uniform(-0.5, 0.5, size=(100, 3))
    exact = np.linalg.norm(T[:, :3, 3] - at[None, :3, 3], axis=1) - 0.5
    for kind, bound in ((tx.tables.Linear(), 0.05 * np.sqrt(3.0)), (tx.tables.BSpline(), 0.05 * np.sqrt(3.0))):
        grid = DistanceGrid(axes, table, kind=kind, at=at)
        lowered = tx.lower(signed_distance(grid, Sphere(0.1), None, tx.State("T", (4, 4))))
        off = np.abs(np.asarray(jax.vmap(lambda T: lowered(0.0, {"T": T}))(T)) - exact)  # noqa: B023
        assert off.max() < bound
        assert off[exact > 0.0].max() < 0.02


def test_outside_of_a_grid_the_distance_is_a_lower_bound_with_a_slope() -> None:
    axes = [np.linspace(-0.6, 0.6, 25), np.linspace(-0.5, 0.7, 25), np.linspace(-0.6, 0.8, 29)]
    table = np.linalg.norm(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1), axis=-1) - 0.4  # of a ball
    grid = DistanceGrid(axes, table, tx.tables.Linear(), at=tx.pose(position=[0.3, 0.0, 0.1]))
    ball = tx.lower(signed_distance(grid, Sphere(0.1), None, tx.State("T", (4, 4))))
    border = np.array([[0.9 + 1e-9, 0.2, 0.3], [0.9 - 1e-9, 0.2, 0.3]])
    T = np.tile(np.eye(4), (202, 1, 1))
    T[:, :3, 3] = np.concatenate([np.random.default_rng(2).uniform(-4.0, 4.0, size=(200, 3)), border])
    d, slopes = map(np.asarray, jax.jit(jax.vmap(jax.value_and_grad(lambda T: ball(0.0, {"T": T}))))(T))
    away = T[:, :3, 3] - [0.3, 0.0, 0.1]
    exact, n = np.linalg.norm(away, axis=1) - 0.5, away / np.linalg.norm(away, axis=1)[:, None]
    outside = (np.abs(away - [0.0, 0.1, 0.1]) > [0.6, 0.6, 0.7]).any(axis=1)
    assert outside.sum() > 150
    assert (d <= exact + 2e-3)[outside].all()  # the error of the table
    assert (d > 0.5 * exact)[outside].all()
    assert np.linalg.norm(slopes[:, :3, 3], axis=1)[outside].max() < 1.05
    assert np.sum(slopes[:, :3, 3] * n, axis=1)[:200][outside[:200]].min() > 0.2
    np.testing.assert_allclose(*d[-2:], atol=1e-8)


def test_what_has_no_distance(unchecked: None) -> None:
    balls = {"a": Sphere(0.1), "b": Sphere(0.1)}
    wrong: list[tuple[Any, str]] = [
        (lambda: ConvexPolytope(np.eye(3)), "span a volume"),
        (lambda: ConvexPolytope(np.full((8, 3), np.nan)), "finite"),
        (lambda: ConvexPolytope(CORNERS, radius=-1.0), "radius of 0 or more"),
        (lambda: ConvexPolytope(CORNERS, most=3), "most to be 4"),
        (
            lambda: signed_distance(DistanceGrid([np.arange(4.0)] * 3, np.ones((4, 4, 4))), Box(LENGTHS)),
            "a Sphere as the partner",
        ),
        (lambda: DistanceGrid([np.arange(4.0)] * 3, np.ones((4, 4))), "shape"),
        (lambda: clearances(mechanics.chain_models.equal_links(2)), "links with collision geometry"),
        (lambda: clearances(mechanics.chain_models.equal_links(2), {"joint1": Sphere(0.1)}), "all pairs are excluded"),
        (lambda: clearances(floating("ab"), balls, far=-1.0), "far must be a distance"),
        (lambda: clearances(floating("ab"), {"a": Sphere(0.1), "b": []}), "got none for 'b'"),
        (lambda: clearances(floating("ab"), [Sphere(0.1)]), "solids by name"),  # type: ignore[arg-type]
        (lambda: clearances(floating("ab"), balls, ignored=[("a", "bb")]), "ignored has 'bb'"),
        (lambda: clearances(floating("ab"), balls, ignored=["ab"]), "ignored expects pairs of names"),  # type: ignore[list-item]
        (lambda: soft_minimum([], 0.1), "got none"),
        (lambda: soft_minimum([tx.Constant(1.0)], 0.0), "width"),
    ]
    for call, message in wrong:
        with pytest.raises((InputError, ModelError), match=message):
            call()


# ---- many pairs ------------------------------------------------------------------------------------------------------


def hulls(count: int) -> dict[str, ConvexPolytope]:
    """Polytopes of 5, 9, 13, ... points, with a radius."""
    rng = np.random.default_rng(7)
    return {f"p{k}": ConvexPolytope(0.4 * rng.normal(size=(5 + 4 * k, 3)), 0.01 * k) for k in range(count)}


def floating(names: Iterable[str]) -> Mechanism:
    body = mechanics.SpatialInertia(mass=1.0, inertia=np.eye(3))
    return Mechanism([Link(joints.Free(name), body, np.eye(4)) for name in names])


def test_more_hulls_than_a_table_has() -> None:
    """Prisms with so many corners that a table has two: three make two tables."""
    angles = np.linspace(0.0, 2.0 * np.pi, 160, endpoint=False)
    ring = np.stack([np.cos(angles), np.sin(angles), 0.0 * angles], axis=1)
    heights = {"a": 0.2, "b": 0.4, "c": 0.8}
    solids = {
        name: ConvexPolytope(np.concatenate([0.3 * ring + [0.0, 0.0, s * h] for s in (-0.5, 0.5)]), radius=0.01)
        for name, h in heights.items()
    }
    pairs = clearances(floating(solids), solids)
    for z in ({"a": 0.0, "b": 1.0, "c": 2.0}, {"a": 1.7, "b": 0.3, "c": 0.0}):  # apart, and b in c
        gaps = evaluated(pairs, {f"{name}_position": tx.pose(position=[0.0, 0.1, z[name]]) for name in solids})
        for a, b in ("ab", "ac", "bc"):
            expected = abs(z[a] - z[b]) - 0.5 * (heights[a] + heights[b]) - 0.02
            assert gaps[f"{a}-{b}"] == pytest.approx(expected, abs=1e-12)


AT = tx.pose(position=[0.1, 0.0, 0.2], quaternion=[0.8, 0.6, 0.0, 0.0])
HULL, BOX = ConvexPolytope(POINTS[0], at=AT), Box((0.5, 0.6, 0.3), at=AT)
ROD, BALL = Capsule(0.1, 0.9, at=AT), Sphere(0.2)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("solids", "obstacles"),
    [
        (hulls(2), {"hull": HULL, "box": BOX, "rod": ROD, "ball": BALL}),
        ({"p0": Box(LENGTHS), "p1": BOX}, {"board": Box((0.9, 0.6, 0.1), at=AT)}),
    ],
    ids=["polytopes", "boxes"],
)
def test_many_pairs_share_a_search(solids: Any, obstacles: Any) -> None:
    """Each distance is that of the pair alone: separate, overlapping, with boxes, segments and points."""
    pairs = clearances(floating(solids), solids, obstacles)
    frames, every = {name: tx.State(f"{name}_position", group=tx.SE3) for name in solids}, solids | obstacles
    names = [name.split("-") for name in pairs]
    alone = [signed_distance(every[a], every[b], frames.get(a), frames.get(b)) for a, b in names]
    shared, separate = (tx.lower(tx.Stack(*some)) for some in (pairs.values(), alone))
    weights = np.linspace(1.0, 2.0, len(alone))

    def values_and_slopes(of: Any, dtype: Any) -> Any:
        def weighted(x: Any) -> Any:
            return of(0.0, x) @ weights.astype(dtype)

        T = poses(60, 0.4)[0].reshape(30, 2, 4, 4).astype(dtype)
        x = {f"{name}_position": T[:, k] for k, name in enumerate(solids)}
        slopes = jax.vmap(tx.tangent_grad(weighted, tx.Product(dict.fromkeys(x, tx.SE3))))
        return np.asarray(jax.jit(jax.vmap(lambda x: of(0.0, x)))(x)), np.asarray(jax.jit(slopes)(x))

    gaps, slopes = values_and_slopes(shared, float)
    expected, expected_slopes = values_and_slopes(separate, float)
    assert len(alone) == (9 if "ball" in obstacles else 3)
    assert 20 < (gaps < 0.0).sum() < gaps.size - 20
    np.testing.assert_allclose(gaps, expected, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(slopes, expected_slopes, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(values_and_slopes(shared, np.float32)[0], expected, rtol=0.0, atol=2e-6)


def kernels_of(solids: dict[str, Any], obstacles: dict[str, Any]) -> int:
    """The number of kernels that the distances of floating solids compile."""
    made = list[str]()

    def listen(event: str, seconds: float, **_: Any) -> None:
        made.append(event)

    pairs = clearances(floating(solids), solids, obstacles)
    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        evaluated(pairs, {f"{name}_position": np.eye(4) for name in solids})
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)
    return made.count("/twistax/kernel")


def test_more_pairs_compile_no_search() -> None:
    few, many = (kernels_of(hulls(count), {}) for count in (3, 5))
    assert 0 < many == few


@pytest.mark.thorough
def test_cylinders_share_a_search() -> None:
    rods = {name: Capsule(0.1, 0.3, at=tx.pose(position=[x, 0.0, 0.0])) for name, x in (("a", 1.0), ("b", 2.0))}
    cans = {"can": Cylinder(0.2, 0.5), "tin": Cylinder(0.3, 0.4)}
    few = kernels_of({"a": rods["a"]}, {"can": cans["can"]})
    assert 0 < kernels_of(rods, {"can": cans["can"]}) == kernels_of(rods, cans) == few
