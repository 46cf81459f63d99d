"""Signed distances of cylinders: closed forms, a search over directions, Coal, continuity, derivatives, no NaN."""

import functools
from typing import Any

import jax
import numpy as np
import pytest
from test_distances import poses
from test_witness import SOLIDS, by_coal, lowered

import twistax as tx
from twistax.mechanics import ConvexPolytope, signed_distance
from twistax.view import Box, Capsule, Cylinder

COUNT = 240
CORNERS = np.random.default_rng(5).normal(size=(14, 3)) * 0.35
OTHERS: dict[str, Any] = {
    "box": Box((0.4, 0.7, 1.1)),
    "cylinder": Cylinder(0.45, 0.3),
    "capsule": Capsule(0.2, 0.9),
    "polytope": ConvexPolytope(CORNERS, radius=0.05),
}
CYLINDER = Cylinder(0.3, 0.8)
QUICK = ["box", "cylinder"]
ALL = [*QUICK, *(pytest.param(name, marks=pytest.mark.thorough) for name in ("capsule", "polytope"))]


@functools.cache
def compiled(other: str) -> Any:
    distance = tx.lower(signed_distance(CYLINDER, OTHERS[other], None, tx.State("B", (4, 4))))
    return jax.jit(jax.vmap(lambda T: distance(0.0, {"B": T})))


def distances(other: str, T: np.ndarray) -> np.ndarray:
    parts = [compiled(other)(part) for part in T.reshape(-1, COUNT, 4, 4)]
    return np.concatenate([np.asarray(part) for part in parts])


def supports(other: str, n: np.ndarray) -> np.ndarray:
    """How far a solid reaches along directions (..., 3) in its frame."""
    if other == "first":
        return 0.4 * np.abs(n[..., 2]) + 0.3 * np.hypot(n[..., 0], n[..., 1])
    if other == "cylinder":
        return 0.15 * np.abs(n[..., 2]) + 0.45 * np.hypot(n[..., 0], n[..., 1])
    if other == "capsule":
        return 0.45 * np.abs(n[..., 2]) + 0.2
    if other == "box":
        return np.abs(n) @ [0.2, 0.35, 0.55]
    return (n @ CORNERS.T).max(axis=-1) + 0.05


def by_search(other: str, T: np.ndarray) -> np.ndarray:
    """The greatest gap over directions: 3,000 of them, and cones around the best 12 that shrink."""

    def gap(n: np.ndarray) -> np.ndarray:
        R, p = T[:3, :3], T[:3, 3]
        return n @ p - supports("first", n) - supports(other, -n @ R)

    rng = np.random.default_rng(0)
    n = rng.normal(size=(3000, 3))
    n /= np.linalg.norm(n, axis=1)[:, None]
    n = n[np.argsort(gap(n))[-12:]]
    around = np.concatenate([np.zeros((1, 3)), rng.normal(size=(60, 3))])
    for width in 0.05 * 0.6 ** np.arange(45):
        tried = n[:, None] + width * around
        tried /= np.linalg.norm(tried, axis=2)[..., None]
        n = tried[np.arange(len(n)), gap(tried).argmax(axis=1)]
    return np.asarray(gap(n).max())


def turned(axis: str, angle: float, *position: float) -> np.ndarray:
    T, (i, j) = np.eye(4), {"x": (1, 2), "y": (2, 0)}[axis]
    T[i, i] = T[j, j] = np.cos(angle)
    T[i, j], T[j, i] = -np.sin(angle), np.sin(angle)
    T[:3, 3] = position
    return T


def test_closed_forms() -> None:
    quarter, eighth, slant = 0.5 * np.pi, 0.25 * np.pi, np.sqrt(0.5)
    expected = {
        "box": [
            (turned("x", 0.0, 0.0, 0.0, 1.4), 1.4 - 0.4 - 0.55),  # face above an end
            (turned("x", 0.0, 0.1, 0.0, 0.9), -0.05),
            (turned("x", 0.0, 0.8, 0.0, 0.1), 0.8 - 0.2 - 0.3),  # face beside the side
            (turned("x", 0.0, 0.45, 0.0, 0.1), -0.05),
            (turned("x", quarter, 0.9, 0.0, 0.0), 0.9 - 0.2 - 0.3),
            (turned("x", 0.0, 0.7, 0.85, 0.1), np.hypot(0.5, 0.5) - 0.3),  # edge beside the side
            (turned("x", 0.0, 0.2 + 0.6 * 0.2, 0.35 + 0.8 * 0.2, 0.1), 0.2 - 0.3),
            (turned("y", eighth, 0.0, 0.0, 1.5), 1.5 - (0.55 + 0.2) * slant - 0.4),  # edge above an end
            (turned("y", eighth, 1.5, 0.0, 0.0), 1.5 - (0.55 + 0.2) * slant - 0.3),
            (turned("x", 0.0, 0.3 + 0.2 + 0.3, 0.0, 0.4 + 0.55 + 0.4), 0.5),  # edge beside a rim
            (turned("x", 0.0, 0.2, 0.35, 0.1), -0.3),  # an edge on the axis
            (turned("x", 0.0, 0.2 + 0.1, 0.35, 0.1), 0.1 - 0.3),
        ],
        "cylinder": [
            (turned("x", 0.0, 0.0, 0.0, 1.0), 1.0 - 0.4 - 0.15),
            (turned("x", 0.0, 0.1, 0.0, 0.5), -0.05),
            (turned("x", 0.0, 1.0, 0.0, 0.1), 0.25),
            (turned("x", 0.0, 0.6, 0.0, 0.1), -0.15),
            (turned("x", 0.0, 1.05, 0.0, 0.95), 0.5),  # rims, 0.3 and 0.4 apart
            (turned("x", 0.0, 0.0, 0.75 + 0.08, 0.55 + 0.06), 0.1),
            (turned("x", quarter, 1.0, 0.0, 0.0), 0.25),  # sides that cross
            (turned("x", quarter, 0.7, 0.0, 0.0), -0.05),
            (turned("y", eighth, 0.0, 0.0, 1.2), 1.2 - 0.4 - 0.6 * slant),  # rim above an end
            (turned("y", eighth, 0.0, 0.0, 0.8), 0.8 - 0.4 - 0.6 * slant),
            (turned("y", eighth, 1.2, 0.0, 0.0), 1.2 - 0.3 - 0.6 * slant),
        ],
    }
    for other, cases in expected.items():
        T = np.stack([T for T, _ in cases] + [np.eye(4)] * (COUNT - len(cases)))
        np.testing.assert_allclose(distances(other, T)[: len(cases)], [d for _, d in cases], atol=1e-12, rtol=0.0)


@pytest.mark.parametrize("other", ALL)
def test_the_greatest_gap_over_all_directions(other: str) -> None:
    T = poses(COUNT, 0.45)[1][:60]
    d = distances(other, np.concatenate([T] * 4))[:60]
    less = d - [by_search(other, place) for place in T]
    assert min((d < -0.05).sum(), (d > 0.05).sum()) > 8
    assert less.min() > -1e-12
    assert less.max() < 3e-4  # the search stops at kinks; that it is not less, the points on both solids show


@pytest.mark.thorough
@pytest.mark.parametrize("other", OTHERS)
def test_continuous_with_slope_one(other: str) -> None:
    """Along a line the distance changes by at most the way, through contact and between directions of least depth."""
    A, B = poses(20, 1.0)
    s = np.linspace(-1.0, 1.0, 12 * COUNT // len(A), dtype=float)
    T = np.repeat(B[:, None], len(s), axis=1)
    T[:, :, :3, 3] = 1.5 * s[None, :, None] * A[:, None, :3, 0] + 0.15 * B[:, None, :3, 1]
    d = distances(other, T.reshape(-1, 4, 4)).reshape(len(A), -1)
    assert ((d < 0.0).any(axis=1) & (d > 0.1).any(axis=1)).all()
    assert np.abs(np.diff(d, axis=1)).max() <= 1.5 * (s[1] - s[0]) + 1e-12


@pytest.mark.thorough
@pytest.mark.parametrize("pair", [("cylinder", "box"), ("cylinder", "cylinder"), ("capsule", "cylinder")])
def test_as_coal_has_it(pair: tuple[str, str]) -> None:
    A, B = poses(200, 0.9)
    expected, near = by_coal(pair, A, B)[:, 0], lowered(pair)(A, B)
    d, n = np.asarray(near["d"]), np.asarray(near["n"])
    assert np.abs(d - expected)[expected > 1e-3].max() < 1e-6
    inside = d < -1e-2
    assert inside.sum() > 10
    assert (d - expected)[inside].min() > -1e-6  # Coal's depth is at times not the least one, or infinite
    assert np.mean(np.abs(d - expected)[inside] < 1e-6) > 0.7
    moved = B.copy()
    moved[:, :3, 3] -= d[:, None] * n
    assert np.abs(np.asarray(lowered(pair)(A, moved)["d"]))[inside].max() < 1e-10


@pytest.mark.thorough
@pytest.mark.parametrize("other", OTHERS)
def test_first_and_second_derivatives(other: str) -> None:
    xi, T = tx.State("xi", (6,)), tx.State("B", (4, 4))
    at = tx.lower(signed_distance(CYLINDER, OTHERS[other], None, tx.lie.Compose(T, tx.lie.SE3Exp(xi))))
    gradient = jax.grad(lambda x, B: at(0.0, {"xi": x, "B": B}))
    g, H = jax.jit(jax.vmap(gradient)), jax.jit(jax.vmap(jax.jacfwd(gradient)))
    f = jax.jit(jax.vmap(lambda x, B: at(0.0, {"xi": x, "B": B})))
    B = poses(60, 0.5)[1]
    x, h = np.random.default_rng(1).normal(size=(60, 6)) * 1e-2, 1e-5
    assert min((np.asarray(f(x, B)) < -0.05).sum(), (np.asarray(f(x, B)) > 0.05).sum()) > 8
    slopes, curves = np.asarray(g(x, B)), np.asarray(H(x, B))
    moves = [h * unit for unit in np.eye(6)[:, None]]
    first = np.stack([(f(x + move, B) - f(x - move, B)) / (2.0 * h) for move in moves], axis=1)
    second = np.stack([(g(x + move, B) - g(x - move, B)) / (2.0 * h) for move in moves], axis=1)
    assert np.mean(np.abs(first - slopes).max(axis=1) < 1e-6) > 0.95
    off = np.abs(second - curves).max(axis=(1, 2)) / (1.0 + np.abs(curves).max(axis=(1, 2)))
    assert np.mean(off < 1e-6) > 0.93
    assert np.abs(curves - np.swapaxes(curves, 1, 2)).max() < 1e-6 * np.abs(curves).max()


@pytest.mark.thorough
@pytest.mark.parametrize("other", OTHERS)
def test_aligned_solids_have_no_nan(other: str) -> None:
    T, places = tx.State("T", (4, 4)), [np.eye(4)]
    for axis in "xy":
        places += [turned(axis, 0.5 * np.pi * k, *p) for k in range(4) for p in ((0.0, 0.0, 0.0), (0.0, 0.0, 0.55))]
    at = tx.lower(signed_distance(CYLINDER, OTHERS[other], None, T))
    value = jax.value_and_grad(lambda T: at(0.0, {"T": T}))
    d, slope = jax.jit(jax.vmap(value))(np.stack(places))
    hessian = jax.jit(jax.vmap(jax.jacfwd(lambda T: value(T)[1])))(np.stack(places))
    assert all(np.isfinite(np.asarray(one)).all() for one in (d, slope, hessian))
    single = jax.jit(jax.vmap(value))(np.stack(places).astype(np.float32))
    assert single[0].dtype == np.float32
    np.testing.assert_allclose(single[0], d, atol=2e-6)
    assert np.isfinite(np.asarray(single[1])).all()


@pytest.mark.thorough
@pytest.mark.parametrize("other", ["box", pytest.param("polytope", marks=pytest.mark.thorough)])
def test_single_precision(other: str) -> None:
    T = poses(COUNT, 0.3)[1]
    expected = distances(other, T)
    np.testing.assert_allclose(compiled(other)(T.astype(np.float32)), expected, rtol=0.0, atol=3e-6)
    assert (expected < -0.05).sum() > 20


def test_places_count_and_the_order_does_not() -> None:
    high = Cylinder(0.2, 1.0, at=(0.0, 0.0, 2.0))
    for a, b in ((high, SOLIDS["cylinder"]), (SOLIDS["cylinder"], high)):
        assert float(tx.lower(signed_distance(a, b))(0.0, {})) == pytest.approx(2.0 - 0.5 - 0.4, abs=1e-13)
