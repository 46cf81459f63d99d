"""Bodies in a row, neighbours tied by springs between points beside their centres of mass."""

from __future__ import annotations

import functools
import itertools

import numpy as np

import twistax as tx

from .arrays import Array, about, placed
from .scene import Scene

__all__ = ["LENGTH", "MASSES", "MOMENTS", "POINTS", "SPRING_BODIES", "STIFFNESS", "scene", "start", "system"]

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
    poses = [tx.State(f"g{i + 1}", group=tx.SE3) for i in range(count)]
    twists = [tx.State(f"V{i + 1}", shape=(6,)) for i in range(count)]
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
    momentum: tx.Expr = tx.Constant(np.zeros(6))
    for g, V, M, applied in zip(poses, twists, inertias, wrenches):
        rates |= {g: V, V: (functools.reduce(tx.Add, applied) - tx.lie.AdjointDual(V, M * V)) / M}
        energy = energy + 0.5 * tx.linalg.Dot(V, M * V)
        momentum = momentum + tx.lie.SE3AdjointDual(g) @ (M * V)
    outputs = {
        "energy": energy,
        "linear_momentum": tx.lie.linear(momentum),
        "angular_momentum": tx.lie.angular(momentum),
    }
    return tx.System(rates=rates, outputs=outputs)


def _at(g: tx.State, point: Array, force: tx.Expr) -> tx.Expr:
    """The body wrench (6,) of a force in world axes that acts at a point of the body."""
    frame = tx.lie.Pose(rotation=g[:3, :3].T, position=point)  # world axes at the point -> body
    return tx.lie.SE3AdjointDual(frame) @ tx.lie.wrench(force=force, torque=np.zeros(3))


def start(count: int = 4) -> dict[str, Array]:
    """Bodies 1.6 m apart along x, each turned further about z than the one before, with different twists."""
    found = {}
    for i in range(count):
        found[f"g{i + 1}"] = placed(about((0.0, 0.0, 1.0), 0.3 * i), [1.6 * i, 0.1 * (-1.0) ** i, 0.0])
        linear = [0.2 * np.cos(1.0 * i), 0.3 * np.sin(2.0 * i), -0.1 * i]
        found[f"V{i + 1}"] = np.array([*linear, 0.5 * np.sin(1.0 + i), 0.4 * np.cos(3.0 * i), 0.3 + 0.2 * i])
    return found


# fmt: off
#: As `python -m twistax.scenes.references spring-bodies` finds it.
_END = {
    "g1": np.array(
        [
            [0.701314461933754, 0.5727353401570368, 0.42441990483219844, 4.171161722881101],
            [0.4338713085350485, -0.8153523096861295, 0.38334879511950826, -0.5942973038341022],
            [0.565609152253262, -0.08470443450432413, -0.8203117978321712, -0.9508728933001191],
            [0.0, 0.0, 0.0, 1.0],
        ]
    ),
    "V1": np.array([-0.5258985020064018, 0.2963979871721877, 0.5854722313635667, 0.3018296884287675,
                    2.211290104792807, 0.4254294013972749]),
    "g2": np.array(
        [
            [-0.22859988820875088, -0.36956926469395324, 0.9006445745711885, 3.50055324027401],
            [0.8560397186012076, 0.36426614137906377, 0.36675083970179667, -0.3716879680313104],
            [-0.46361416208751827, 0.854826729131921, 0.23309477015477997, -1.0075658227786857],
            [0.0, 0.0, 0.0, 1.0],
        ]
    ),
    "V2": np.array([0.048947461607573926, -0.17676550976015223, -0.10316103945457503, 0.00335929158248328,
                    -0.34177702457625797, -0.6729416462717195]),
    "g3": np.array(
        [
            [-0.2646133225123655, 0.16282397064885132, 0.9505094129629169, 2.3538838682573893],
            [-0.832816601296443, 0.4583553083630129, -0.31036578403633497, -0.4207623596864046],
            [-0.4862060243909041, -0.8737269401120634, 0.014315584808251444, -1.2465253289849572],
            [0.0, 0.0, 0.0, 1.0],
        ]
    ),
    "V3": np.array([-0.331065494904065, -0.11644441950022166, 0.2051718374594049, 0.3864227427437476,
                    0.940006215437081, 0.031639334903589375]),
    "g4": np.array(
        [
            [-0.28486569092478226, -0.2394576662535475, 0.9281764725559203, 1.8344222733637567],
            [0.9229563983853906, -0.3299943580562442, 0.19812927681318449, 0.1461238649561993],
            [0.25884942498181185, 0.9131066475080838, 0.3150130560201171, -1.8447277145619387],
            [0.0, 0.0, 0.0, 1.0],
        ]
    ),
    "V4": np.array([-0.2111306123990613, -0.13166585077195356, -0.33909150829782647, -0.8061916331043224,
                    0.5724508985280433, -0.060416067449952954]),
}
# fmt: on


def scene(count: int = 4) -> Scene:
    """The scene with so many bodies. The true end is known for four."""
    return Scene(
        name="spring-bodies",
        title=f"{count} bodies tied by springs",
        summary=(
            f"{count} bodies of 1 to 2 kg, tied in a row by springs of {STIFFNESS:g} N/m beside their centres of mass, "
            "swing and turn for 8 s: rotation and translation of all of them depend on each other."
        ),
        source="written for this scene; Newton-Euler with the wrench of each spring",
        build=functools.partial(system, count),
        start=start(count),
        duration=8.0,
        reference=_END if count == 4 else None,
        invariants=("energy", "linear_momentum", "angular_momentum"),
    )


SPRING_BODIES = scene()
