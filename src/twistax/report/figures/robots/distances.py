"""Distances of solids in batches of poses, beside Coal, called for one pair after the other."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np
from numpy import ndarray as Array

import twistax as tx

from ....mechanics import ConvexPolytope, signed_distance
from ....view import Box, Cylinder
from ...harness.expected import at_most, between, needed
from ...harness.measurement import Section, slow
from ...harness.timing import Race, Timed, batch

_POSES = 1000
_CORNERS = np.random.default_rng(0).normal(size=(14, 3)) * 0.3
_SOLIDS: dict[str, Any] = {
    "polytope": ConvexPolytope(_CORNERS),
    "box": Box((0.4, 0.7, 1.1)),
    "cylinder": Cylinder(0.2, 0.9),
}


def _poses() -> Array:
    """Random attitudes; positions of which some overlap."""
    rng, poses = np.random.default_rng(1), np.tile(np.eye(4), (_POSES, 1, 1))
    poses[:, :3, :3] = jax.vmap(tx.SO3.exp)(rng.normal(size=(_POSES, 3)))
    poses[:, :3, 3] = 0.9 * rng.normal(size=(_POSES, 3))
    return poses


def _coal(name: str) -> Any:
    coal = needed("coal", "pin")
    if name == "box":
        return coal.Box(0.4, 0.7, 1.1)
    if name == "cylinder":
        return coal.Cylinder(0.2, 0.9)
    from scipy.spatial import ConvexHull

    hull, corners, triangles = ConvexHull(_CORNERS), coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    for point in _CORNERS:
        corners.append(point)
    for triangle, plane in zip(hull.simplices, hull.equations, strict=True):
        a, b, c = _CORNERS[triangle]
        outward = np.cross(b - a, c - a) @ plane[:3] > 0.0
        triangles.append(coal.Triangle(*map(int, triangle if outward else triangle[::-1])))
    return coal.Convex(corners, triangles)


def _programs(one: str, other: str) -> dict[str, Timed]:
    coal, poses = needed("coal", "pin"), _poses()
    T, outputs = tx.State("T", group=tx.SE3), {}
    outputs["d"] = signed_distance(_SOLIDS[one], _SOLIDS[other], np.eye(4), T)
    dynamics = tx.compile(tx.System(rates={T: np.zeros(6)}, outputs=outputs), backend=tx.Native(threads=1))
    solids, request = (_coal(one), _coal(other)), coal.DistanceRequest(True)
    here = coal.Transform3s(np.eye(3), np.zeros(3))
    places = [coal.Transform3s(pose[:3, :3], pose[:3, 3]) for pose in poses]

    def theirs() -> Array:
        result = [coal.distance(solids[0], here, solids[1], at, request, coal.DistanceResult()) for at in places]
        return np.maximum(result, 0.0)  # of solids that overlap Coal's depth is not always the least one

    ours = batch(lambda pose: jax.numpy.maximum(dynamics.outputs(0.0, {"T": pose})["d"], 0.0), poses)
    return {"ours": ours, "Coal": Timed(theirs, _POSES)}


def _rows(one: str, other: str) -> Section:
    race, what = Race(lambda: _programs(one, other), 1e-5), f"distance of a {one} and a {other}, {_POSES:,} poses"
    return [
        slow(f"{what}: a pair", "signed_distance, jax.vmap", at_most(20.0, "us"), race.seconds, "ours", 1e-6),
        slow(f"{what}: time", "over that of Coal", between(), race.ratio, "ours", "Coal"),
    ]


DISTANCES: Section = [
    *_rows("polytope", "polytope"),
    *_rows("cylinder", "box"),
    *_rows("cylinder", "cylinder"),
]
