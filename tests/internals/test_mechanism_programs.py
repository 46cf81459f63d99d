"""Derivatives of a mechanism's dynamics as programs of scalars, against differences in extended precision."""

from __future__ import annotations

import pickle
from collections.abc import Mapping
from typing import Any

import jax
import numpy as np
import pytest
from joints_of_every_kind import Tree, free_tree, mimicking_tree
from mechanics_oracles import Cloud, body_of, pose

import twistax as tx
from oracles import hat
from twistax import mechanics
from twistax.expr import leaves_of
from twistax.mechanics import Drive, Link, Mechanism, SpatialInertia, chain_models, joints, mechanism_system
from twistax.mechanics.algorithms.system_slopes import scalars_of_slopes
from twistax.scalar.graph import TooLarge
from twistax.scalar.program import ScalarProgram
from twistax.scalar.reader import scalarize
from twistax.scalar.targets.llvm.kernel_body import by_numpy
from twistax.system import functions as system_functions
from twistax.system.jacobian import LARGEST

LONG = np.longdouble


_OPERATIONS: Mapping[str, Any] = {
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "div": np.divide,
    "neg": np.negative,
    "sqrt": np.sqrt,
    "sin": np.sin,
    "cos": np.cos,
}


def in_extended_precision(program: ScalarProgram, arguments: list[np.ndarray]) -> list[np.ndarray]:
    """The results for arguments of long numbers, all with one axis of points in front."""
    g, found = program.graph, dict[int, Any]()
    for i in program.live:
        place, operation = g.input_of(i), g.operation(i)
        if place is not None:
            found[i] = arguments[place[0]].reshape(len(arguments[0]), -1)[:, place[1]]
        elif operation is None:
            found[i] = LONG(g.numbers[i])
        else:
            found[i] = _OPERATIONS[operation.name](*(found[a] for a in g.arguments(i)))
    return [
        np.stack([np.broadcast_to(found[i], len(arguments[0])) for i in nodes.reshape(-1).tolist()], axis=1)
        for nodes in program.outputs
    ]


def scalars(values: Mapping[str, np.ndarray], *expressions: tx.Expr) -> ScalarProgram:
    """Their program, of all the values in order."""
    used = {leaf.name for leaf in leaves_of(*expressions)}
    shapes = [jax.ShapeDtypeStruct(value.shape, np.float64) for value in values.values()]
    f = tx.lower(expressions)

    def function(*arrays: jax.Array) -> list[jax.Array]:
        return list(f(0.0, {name: a for name, a in zip(values, arrays, strict=True) if name in used}))

    return scalarize(function, *shapes)


def moved(tree: Tree, values: Mapping[str, np.ndarray], name: str, step: Any) -> dict[str, np.ndarray]:
    """Positions moved by right perturbations, or another argument by its entries: (points, ...), a point a freedom."""
    n, robot = tree.mechanism.dofs, tree.mechanism
    found = {key: np.repeat(value.astype(LONG)[None], n, axis=0) for key, value in values.items()}
    if name != "q":
        found[name] = found[name] + step * np.eye(n, dtype=LONG)
        return found
    for segment in robot.segments:
        if segment.link.mimic is not None:
            continue
        for k, a in enumerate(segment.freedoms):
            joint = segment.link.joint
            if joint.group is not None:
                size, H = joint.group.shape[0], np.asarray(joint.motion_subspace.value)[:, k]
                xi = hat(H)[:size, :size].astype(LONG) * step
                T = found[f"{joint.name}_position"][a]
                found[f"{joint.name}_position"][a] = T + T @ (xi + xi @ xi / 2)
            elif joint.name == "table":
                turn = found["q"][a, segment.coordinates][2]
                along = [[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1]][k]
                found["q"][a, segment.coordinates] += step * np.array(along, LONG)
            else:
                found["q"][a, segment.coordinates.start + k] += step
    return found


@pytest.mark.parametrize(("tree", "forward"), [(free_tree, False), (mimicking_tree, True)])
def test_against_differences_in_extended_precision(tree: Any, forward: bool, unchecked: None) -> None:
    made, rng = tree(), np.random.default_rng(3)
    robot, n = made.mechanism, made.mechanism.dofs
    qd, x = rng.normal(size=(2, n))
    values = made.inputs(qd=qd, x=x)
    pushed = {"tool": np.array([3.0, -1.0, 2.0, 0.5, -0.4, 0.7])}
    plain, by = (
        (mechanics.forward_dynamics, mechanics.forward_dynamics_derivatives)
        if forward
        else (mechanics.inverse_dynamics, mechanics.inverse_dynamics_derivatives)
    )
    third = tx.State("x", (n,))
    program = scalars(values, plain(robot, None, None, third, wrenches=pushed))
    slopes = scalars(values, *by(robot, None, None, third, wrenches=pushed))
    found = in_extended_precision(slopes, [value.astype(LONG)[None] for value in values.values()])
    step = LONG(1e-6)
    for name, own in zip(("q", "qd", "x"), found, strict=True):
        ends = [moved(made, values, name, sign * step) for sign in (1, -1)]
        (up,), (down,) = (in_extended_precision(program, list(end.values())) for end in ends)
        expected = ((up - down) / (2 * step)).T
        assert np.max(np.abs(own.reshape(n, n) - expected)) < 1e-10 * np.max(np.abs(expected)), name


def craft() -> tx.System:
    """A free body, a plate that slides on it and a hinge with a rotor, dampers, a mass to be found, and a wind."""
    rng = np.random.default_rng(11)
    bodies = [body_of(Cloud.random(rng, 4)) for _ in range(3)]
    mass = tx.Parameter("mass", value=2.0)
    bodies[2] = SpatialInertia(mass=mass, center_of_mass=(0.1, 0.0, -0.3), inertia=np.diag([0.3, 0.2, 0.25]))
    hinge = Drive(armature=0.2, damping=tx.Parameter("damping", value=0.4), friction=0.3, stiffness=1.5, gear=3.0)
    robot = Mechanism(
        [
            Link(joints.Free("root"), bodies[0], pose(rng)),
            Link(joints.Planar("table"), bodies[1], pose(rng), parent="root", drive=Drive(damping=0.7)),
            Link(joints.Revolute("hinge", (0.0, 0.6, 0.8)), bodies[2], pose(rng), parent="table", drive=hinge),
        ]
    )
    wind = -0.3 * robot.q["q"][3] * robot.twist("hinge")
    feedback = tx.Concat(np.zeros(9), -2.0 * robot.q["q"][3])
    return robot.system(wrenches={"hinge": wind}, forces=feedback)


def test_systems_use_them(unchecked: None) -> None:
    system, rng, wrt = craft(), np.random.default_rng(4), ("u", "x", "params")
    plain = tx.System(rates={state: system.rates[state.name] for state in system.states}, controls=system.controls)
    x = {state.name: rng.normal(size=state.shape) for state in system.states} | {"root_position": pose(rng)}
    found, operations = [], []
    for each in (system, plain):
        functions = tx.compile(each).functions
        inputs = functions.prepare(0.3, x, {"tau": np.full(system.controls[0].shape, 0.5)})
        jacobian, arrays = functions.rate_jacobian(inputs, wrt)
        blocks = by_numpy(jacobian.program, [np.asarray(a).reshape(1, -1) for a in arrays])
        found.append(dict(zip(jacobian.blocks, blocks, strict=True)))
        operations.append(jacobian.program.operations)
    assert operations[0] < 0.9 * operations[1]
    for kind in wrt:
        np.testing.assert_allclose(found[0][kind], found[1][kind], atol=1e-11 * np.max(np.abs(found[1][kind])))


def test_they_are_built_when_a_jacobian_needs_them(monkeypatch: pytest.MonkeyPatch, unchecked: None) -> None:
    made, build = list[tx.Expr](), mechanism_system.slopes_of_accelerations
    monkeypatch.setattr(mechanism_system, "slopes_of_accelerations", lambda *a: made.append(a[1]) or build(*a))
    system = craft()
    functions = tx.compile(tx.join(system, tx.System(rates={tx.State("s"): 0.0})).renamed("one_")).functions
    assert not made
    assert list(functions.slopes) == ["one_qd"]
    again = pickle.loads(pickle.dumps(system))
    keys = [[expr.key() for pair in one.slopes["qd"] for expr in pair] for one in (system, again)]
    assert keys[0] == keys[1]
    assert len(made) == 1
    # Those of a compiled system contain its simplified accelerations.
    functions = tx.compile(system).functions
    assert functions.slopes
    assert made[1] is functions.families["rates"]["qd"][0]


def test_they_are_not_built_where_they_take_too_many_scalars(monkeypatch: pytest.MonkeyPatch) -> None:
    assert 150_000 < scalars_of_slopes(chain_models.equal_links(29)) < LARGEST
    assert scalars_of_slopes(chain_models.equal_links(30)) > LARGEST
    monkeypatch.setattr(mechanism_system, "slopes_of_accelerations", lambda *a: pytest.fail("they are built"))
    monkeypatch.setattr(system_functions, "LARGEST", 1000)
    functions = tx.compile(chain_models.equal_links(4).system()).functions
    with pytest.raises(TooLarge, match="more than 1000 scalars"):
        functions.rate_jacobian(functions.zeros(), ("x", "u"))
