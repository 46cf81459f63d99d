"""The distances of all pairs of solids of a mechanism that may collide, and their soft minimum."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Collection, Hashable, Iterable, Mapping
from pathlib import Path

from ...checks import instance, listed, number, path_of, short
from ...errors import ModelError, TwistaxError
from ...expr import Expr, LogSumExp, Min
from ...expr.functions.function import Function
from ...expr.lie import Compose, Inverse
from ...progress import watching
from ...view import Box, Cylinder, Mesh, Shape
from ..algorithms.dynamics import checked
from ..kinematic_tree import KinematicTree
from ..models.looks import FilePlane
from ..models.xml_file import read_xml
from ..tree import solids_of
from .distance_grid import DistanceGrid
from .polytope import ConvexPolytope
from .polytope_table import PolytopeTable
from .signed_distance import Solid, placed_pair
from .solids import HalfSpace, rounded

#: From so many polytopes and boxes on, pairs share a search.
_SEVERAL = 3
#: The most names of a file that a message has.
_NAMED = 6
#: Solids that no table has.
_UNBOUNDED = (HalfSpace, DistanceGrid)

Solids = Mapping[str, Solid | Iterable[Solid]]


@watching("clearances")
def clearances(
    mechanism: KinematicTree,
    solids: Solids | None = None,
    obstacles: Solids | None = None,
    *,
    ignored: Iterable[tuple[str, str]] = (),
    srdf: str | Path | None = None,
    far: float | None = None,
) -> dict[str, Expr]:
    """The signed distances (), m, of all pairs of frames that may collide, by names such as "hand-forearm",
    "hand-table".

    Excluded are frames connected by one joint, frames of one rigid body, and the pairs in `ignored` and in the SRDF
    file. If a frame has several solids, the distance is the smallest over them; so it is for pairs whose names are
    equal, such as "a-b", "c" and "a", "b-c". A link without collision geometry in a file that has some has no
    distances, as in Pinocchio and MoveIt.

    Args:
        solids: solids by frame. None: the collision geometry of all links and of the base (`Link.collision`), or the
            shapes of a mechanism that has none, with meshes replaced by convex hulls of 24 corners, whose radius grows
            so that they contain the mesh.
        obstacles: solids by name, in the axes of the base; each is paired with all frames that move.
        ignored: pairs of names of frames or obstacles.
        srdf: a file with `<disable_collisions link1=... link2=.../>`, as MoveIt writes it. Pairs with a link that the
            mechanism does not have are skipped, such as those of a leg after `without`.
        far: None, or the distance, m, of the broad phase: if the spheres around two solids are farther apart than this,
            their distance is returned in place of that of the solids, whose search is left out. It is a lower bound, so
            constraints remain satisfied; the value is discontinuous at the switch. Distances that are formulas are
            always exact: of a `HalfSpace`, a `DistanceGrid` or a ball of a cylinder, and of balls and capsules to
            each other and to boxes.
    Raises:
        ModelError: an unknown frame or name; a name that is both a frame and an obstacle; a solid without a distance
            function; collision geometry that cannot be read, by link; an SRDF file of another robot; no remaining pair.
        InputError: a distance `far` that is negative.

    Example:
        `clearances(arm, {"hand": Sphere(0.1)}, {"table": box})["hand-table"] >= 0.02`
    """
    checked("clearances", mechanism)
    if far is not None:
        number("clearances: far", far, "a distance of 0 or more, in m", lambda size: size >= 0.0)
    by_frame = _of_links(mechanism) if solids is None else _by_name("solids", solids)
    by_obstacle = _by_name("obstacles", obstacles or {})
    if twice := [name for name in by_obstacle if name in by_frame or name in mechanism.frames]:
        raise ModelError(
            f"clearances: {twice[0]!r} is the name of a frame and of an obstacle.\n  fix: use another name"
        )
    places = {name: mechanism.frame(name).segment for name in by_frame} | dict.fromkeys(by_obstacle)
    frames = {name: mechanism.frame_name(name) for name in by_frame} | {name: name for name in by_obstacle}
    skipped = _pairs_of_names(ignored, frames | {name: name for name in mechanism.frames})
    if srdf is not None:
        skipped |= _disabled_pairs(srdf, mechanism)
    poses = {name: mechanism.pose(name) for name in by_frame}
    distances, table = dict[str, Expr](), _table([*by_frame.values(), *by_obstacle.values()], far)
    functions = dict[Hashable, Function]()
    for a, b in itertools.combinations([*by_frame, *by_obstacle], 2):
        if frozenset((frames[a], frames[b])) in skipped or not _may_touch(mechanism, places[a], places[b]):
            continue
        T_a, T_b = poses.get(a), poses.get(b)
        shapes = itertools.product(*({**by_frame, **by_obstacle}[name] for name in (a, b)))
        pairs = [_distance(one, two, T_a, T_b, table, functions) for one, two in shapes]
        name = f"{a}-{b}"
        distances[name] = functools.reduce(Min, ([distances[name]] if name in distances else []) + pairs)
    if not distances:
        raise ModelError("clearances expects frames or obstacles that may collide, but all pairs are excluded")
    return distances


def soft_minimum(distances: Iterable[Expr] | Mapping[str, Expr], width: float) -> Expr:
    """A smooth approximation () of the minimum of values: $-w log sum exp(-d_i / w)$.

    For n values, it is between the minimum minus $w log n$ and the minimum. A single constraint on it keeps all pairs
    apart, with an additional margin of up to $w log n$.

    Args:
        distances: expressions (), such as those of `clearances`.
        width: w, m.
    Raises: InputError for a width that is not positive; ModelError for an empty list of distances.

    Example:
        `soft_minimum(clearances(arm), 0.005) >= 0.02`
    """
    number("soft_minimum: width", width, "a positive number", lambda size: 0.0 < size < math.inf)
    values = list(distances.values() if isinstance(distances, Mapping) else distances)
    if not values:
        raise ModelError("soft_minimum expects distances, got none")
    return values[0] if len(values) == 1 else -width * LogSumExp(*(-d / width for d in values))


def _by_name(argument: str, solids: Solids) -> dict[str, list[Solid]]:
    instance(f"clearances: {argument}", solids, Mapping, "solids by name, such as {'hand': Sphere(0.1)}", ModelError)
    lists = {name: list(value) if isinstance(value, Iterable) else [value] for name, value in solids.items()}
    if empty := [name for name, some in lists.items() if not some]:
        raise ModelError(f"clearances: {argument} expects one or more solids for each name, got none for {empty[0]!r}")
    return lists


def _pairs_of_names(pairs: Iterable[tuple[str, str]], known: Mapping[str, str]) -> set[frozenset[str]]:
    """Pairs of frames without order. Raises ModelError for other objects than pairs, and for names that are not known.

    Args:
        known: the frame or the obstacle of each name.
    """
    instance("clearances: ignored", pairs, Iterable, "pairs of names, such as [('hand', 'table')]", ModelError)
    result = set()
    for pair in pairs:
        if isinstance(pair, str) or not isinstance(pair, Collection) or len(pair) != 2:
            raise ModelError(
                f"clearances: ignored expects pairs of names, such as [('hand', 'table')], got {short(pair)}"
            )
        for name in pair:
            if not isinstance(name, str) or name not in known:
                raise ModelError(
                    f"clearances: ignored has {short(name)}, which is neither a frame nor an obstacle; "
                    f"known are {listed(known, name)}"
                )
        result.add(frozenset(known[name] for name in pair))
    return result


def _disabled_pairs(srdf: str | Path, mechanism: KinematicTree) -> set[frozenset[str]]:
    """The pairs of links whose collisions an SRDF file disables. Raises ModelError for a file of another kind or of
    another robot.
    """
    root = read_xml(path_of("clearances: srdf", srdf), "clearances")
    if root.tag != "robot" or root.first("link"):
        raise ModelError(
            f"clearances: srdf expects an SRDF file, with <robot> and <disable_collisions>, got {str(srdf)!r} with "
            f"<{root.tag}>{' and <link>, a URDF file' if root.tag == 'robot' else ''}"
        )
    pairs = [(element.text("link1"), element.text("link2")) for element in root.all("disable_collisions")]
    if pairs and not any(a in mechanism.frames and b in mechanism.frames for a, b in pairs):
        unknown = dict.fromkeys(name for pair in pairs for name in pair if name not in mechanism.frames)
        raise ModelError(
            f"clearances: the SRDF file {str(srdf)!r} is of another robot: the mechanism has no frames "
            f"{listed(list(unknown)[:_NAMED])}{' ...' if len(unknown) > _NAMED else ''}; it has "
            f"{listed(mechanism.frames)}"
        )
    return {frozenset(pair) for pair in pairs}


def _of_links(mechanism: KinematicTree) -> dict[str, list[Solid]]:
    """The solids of links, by frame. Raises ModelError that names the links whose geometry cannot be read."""
    solids, unread = dict[str, list[Solid]](), dict[str, str]()
    for name, part in [(link.name, link) for link in mechanism.links] + [(mechanism.base, mechanism)]:
        try:
            if of_part := [_solid(shape) for shape in solids_of(part)]:
                solids[name] = of_part
        except TwistaxError as error:
            unread[name] = str(error)
    if unread:
        name, reason = next(iter(unread.items()))
        raise ModelError(
            f"clearances: the collision geometry of the links {listed(unread)} cannot be used.\n"
            f"  {name!r}: {reason}\n"
            "  or pass solids= with the links that matter"
        )
    if not solids:
        raise ModelError("clearances expects links with collision geometry or shapes, or solids by frame")
    return solids


def _solid(shape: Shape) -> Solid:
    """A shape as a solid with a distance function. Raises the errors of unreadable or other shapes."""
    if isinstance(shape, FilePlane):
        return HalfSpace(shape.at)
    if isinstance(shape, Mesh):
        return ConvexPolytope(shape, most=24)
    if not isinstance(shape, Cylinder):
        rounded("clearances", shape)
    return shape


def _may_touch(mechanism: KinematicTree, a: int | None, b: int | None) -> bool:
    """Whether two segments may collide: they are neither one body nor connected by a joint. -1 is the base, None an
    obstacle.
    """
    if a is None or b is None:
        return (a is not None and a >= 0) or (b is not None and b >= 0)
    before = {-1: None} | {i: segment.before for i, segment in enumerate(mechanism.segments)}
    return a != b and before[a] != b and before[b] != a


def _table(solids: Iterable[Iterable[Solid]], far: float | None) -> PolytopeTable | None:
    """The table of all solids that have one, if there is a broad phase, cylinders, or several polytopes or boxes."""
    every = [solid for some in solids for solid in some if not isinstance(solid, _UNBOUNDED)]
    has_cylinder = any(isinstance(solid, Cylinder) for solid in every)
    every = [solid for solid in every if not isinstance(solid, Cylinder)]
    several = sum(isinstance(solid, (ConvexPolytope, Box)) for solid in every) >= _SEVERAL
    if far is None and not has_cylinder and not several:
        return None
    cores = (solid if isinstance(solid, ConvexPolytope) else rounded("clearances", solid) for solid in every)
    return PolytopeTable(cores, far)


def _distance(
    a: Solid,
    b: Solid,
    T_a: Expr | None,
    T_b: Expr | None,
    table: PolytopeTable | None,
    functions: dict[Hashable, Function],
) -> Expr:
    pair, A, B = placed_pair("clearances", a, b, T_a, T_b)
    return pair.distance(Compose(Inverse(A), B), table, functions)
