"""Bodies in a row, with neighbours connected by springs between points off their centres of mass."""

from __future__ import annotations

import functools
import itertools

import numpy as np

import twistax as tx

from .scene import Array, Scene, about, placed, said, stored_end, total_momentum

#: Stiffness of a spring, N/m, and its length at rest, m.
STIFFNESS, LENGTH = 20.0, 0.9
#: Masses, kg, and principal moments of inertia, kg m2; bodies take them in turn.
MASSES = (1.0, 1.5, 2.0)
MOMENTS = ((0.10, 0.15, 0.20), (0.30, 0.18, 0.25), (0.35, 0.45, 0.25))
#: Where the springs to the body before and to the body after are tied, in body axes from the centre of mass, m.
POINTS = np.array([[-0.4, 0.1, 0.2], [0.5, -0.2, 0.1]])


def system(count: int = 4) -> tx.System:
    """States g1, V1, g2, V2, ... up to count: poses (body to world, at the centres of mass) and body twists.

    M V' = F - ad*_V(M V), with F from the springs: f = STIFFNESS (d - LENGTH) along the line between the points, d
    apart, as a wrench in world axes at each point, brought to the body by Ad*.

    Outputs, constant in the true motion: energy, J; linear_momentum (3,), N s, and angular_momentum (3,) about the
    world's origin, N m s, in world axes.

    Raises:
        InputError: fewer than two bodies.
    """
    if count < 2:
        raise tx.InputError(f"spring bodies: count must be 2 or more, got {count!r}")
    bodies = [f"body {i + 1}" for i in range(count)]
    poses = [tx.State(f"g{i + 1}", group=tx.SE3, kind=tx.kinds.Pose("world", body)) for i, body in enumerate(bodies)]
    kinds = [tx.Twist(body, of=body, relative_to="world") for body in bodies]
    twists = [tx.State(f"V{i + 1}", shape=(6,), kind=kind) for i, kind in enumerate(kinds)]
    inertias = [np.array([*3 * (MASSES[i % 3],), *MOMENTS[i % 3]]) for i in range(count)]
    wrenches: list[list[tx.Expr]] = [[] for _ in range(count)]
    energy: tx.Expr = tx.Constant(0.0)
    before, after = POINTS
    for i, (g, h) in enumerate(itertools.pairwise(poses)):
        between = tx.lie.Act(h, before) - tx.lie.Act(g, after)
        d = tx.linalg.Norm(between)
        force = STIFFNESS * (1.0 - LENGTH / d) * between
        wrenches[i].append(_at(g, after, force))
        wrenches[i + 1].append(_at(h, before, -force))
        energy = energy + 0.5 * STIFFNESS * (d - LENGTH) ** 2

    rates: dict[tx.State | str, tx.Expr] = {}
    for g, V, M, applied in zip(poses, twists, inertias, wrenches):
        rates |= {g: V, V: (functools.reduce(tx.Add, applied) - tx.lie.AdjointDual(V, M * V)) / M}
        energy = energy + 0.5 * tx.linalg.Dot(V, M * V)
    momenta = [M * V for M, V in zip(inertias, twists)]
    return tx.System(rates=rates, outputs={"energy": energy, **total_momentum(poses, momenta)})


def _at(g: tx.State, point: Array, force: tx.Expr) -> tx.Expr:
    """The body wrench (6,) of a force in world axes that acts at a point of the body."""
    frame = tx.lie.Pose(rotation=g[:3, :3].T, position=point)  # world axes at the point -> body
    return tx.lie.SE3AdjointDual(frame) @ tx.lie.wrench(force=force, torque=np.zeros(3))


def start(count: int = 4) -> dict[str, Array]:
    """Bodies 1.6 m apart along x, each rotated further about z than the previous one, with different twists."""
    states = {}
    for i in range(count):
        states[f"g{i + 1}"] = placed(about((0.0, 0.0, 1.0), 0.3 * i), [1.6 * i, 0.1 * (-1.0) ** i, 0.0])
        linear = [0.2 * np.cos(1.0 * i), 0.3 * np.sin(2.0 * i), -0.1 * i]
        states[f"V{i + 1}"] = np.array([*linear, 0.5 * np.sin(1.0 + i), 0.4 * np.cos(3.0 * i), 0.3 + 0.2 * i])
    return states


def scene(count: int = 4) -> Scene:
    """The scene with this number of bodies. The exact final state is known for four."""
    return Scene(
        **said("spring-bodies", count=count),
        build=functools.partial(system, count),
        start=start(count),
        duration=8.0,
        reference=stored_end("spring-bodies") if count == 4 else None,
        invariants=("energy", "linear_momentum", "angular_momentum"),
    )


SPRING_BODIES = scene()
