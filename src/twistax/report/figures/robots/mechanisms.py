"""Robots from their files: operations, compile times, and run times compared with Pinocchio, whose results are checked
for equality.
"""

import dataclasses
import functools
import importlib.util
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import twistax as tx

from .... import mechanics
from ....mechanics import Drive, Mechanism, chain_models
from ....mechanics.algorithms.derivatives import inverse_dynamics_derivatives
from ....scalar.reader import scalarize
from ...harness.expected import Absent, at_most, needed
from ...harness.measurement import MeasuredCase, Section, quick, slow
from ...harness.timing import Repeats, Timed, agree, batch, in_turn
from ...speed.peers import pinocchio_model

_BATCH = 4096
_DATA = "cmeel.prefix/share/example-robot-data/robots"
#: Where the files are beside the packages, and whether the root link floats.
_FILES = {
    "Panda": ("frax/assets/franka_panda/panda.urdf", False),
    "ANYmal": (f"{_DATA}/anymal_b_simple_description/robots/anymal.urdf", True),
    "Talos": (f"{_DATA}/talos_data/robots/talos_reduced.urdf", True),
    "G1": (f"{_DATA}/g1_description/urdf/g1_29dof_rev_1_0.urdf", True),
}


#: The robots of this section.
_ROBOTS = ("Panda", "ANYmal", "Talos")


def robot_file(robot: str) -> tuple[Path, bool]:
    """The file of a robot, and whether its root link floats. Raises Absent if it is not installed."""
    name, floating = _FILES[robot]
    spec = importlib.util.find_spec("pinocchio")
    for parent in Path(spec.origin).parents if spec and spec.origin else ():
        if (parent / name).exists():
            return parent / name, floating
    raise Absent(f"{name} is not installed")


@functools.cache
def _mechanism(robot: str) -> Mechanism:
    """The robot without damping and friction, which Pinocchio leaves out."""
    if robot not in _FILES:
        return chain_models.equal_links(int(robot.split()[0]))
    path, floating = robot_file(robot)
    read = mechanics.load(path, floating=floating, physical=False)
    return Mechanism([dataclasses.replace(link, drive=Drive()) for link in read.links], read.gravity)


@functools.cache
def _points(robot: str) -> tuple[dict[str, Any], dict[str, Any]]:
    system, rng = _mechanism(robot).system(), np.random.default_rng(20240611)
    x = {state.name: jnp.asarray(rng.normal(size=(_BATCH, *state.shape))) for state in system.states}
    if "root_position" in x:
        x["root_position"] = jax.vmap(tx.SE3.exp)(jnp.asarray(rng.normal(size=(_BATCH, 6))))
    return x, {"tau": jnp.asarray(rng.normal(size=(_BATCH, *system.controls[0].shape)))}


@functools.cache
def _ours(robot: str, part: str) -> tuple[Timed, float]:
    """A batch of the dynamics or their derivatives by one thread, and the processor time to compile it, s."""
    system, (x, u) = _mechanism(robot).system(), _points(robot)
    begin = time.process_time()
    dynamics = tx.compile(system, backend=tx.Native(threads=1))
    before = time.process_time() - begin
    function = dynamics if part == "dynamics" else dynamics.jacobian
    timed = batch(lambda x, u: function(0.0, x, u), x, u)
    return timed, timed.compile_seconds + before


@functools.cache
def _pinocchio(robot: str) -> tuple[Any, np.ndarray, np.ndarray, np.ndarray, list[int]]:
    """Pinocchio's model; positions, velocities and forces of the batch; where our velocities stand among its."""
    pin, (path, floating) = needed("pinocchio", "pin"), robot_file(robot)
    model = pin.buildModelFromUrdf(str(path), *([pin.JointModelFreeFlyer()] if floating else []))
    ours, (x, u) = _mechanism(robot), _points(robot)
    q, order = np.tile(pin.neutral(model), (_BATCH, 1)), list[int]()
    for segment in ours.segments:
        name = segment.link.joint.name
        joint = model.joints[model.getJointId("root_joint" if name == "root" else name)]
        order += range(joint.idx_v, joint.idx_v + joint.nv)
        if joint.nv == 6:
            q[:, joint.idx_q : joint.idx_q + 7] = [pin.SE3ToXYZQUAT(pin.SE3(T)) for T in np.asarray(x["root_position"])]
            continue
        angles = np.asarray(x["q"])[:, segment.coordinates]
        angles = angles if joint.nq == 1 else np.concatenate([np.cos(angles), np.sin(angles)], axis=1)
        q[:, joint.idx_q : joint.idx_q + joint.nq] = angles
    v, tau = np.zeros((2, _BATCH, model.nv))
    v[:, order], tau[:, order[model.nv - u["tau"].shape[1] :]] = x["qd"], u["tau"]
    return model, q, v, tau, order


def _theirs(model: Any, function: Any, q: np.ndarray, v: np.ndarray, third: np.ndarray) -> Timed:
    """A Pinocchio function called point by point. `_over` subtracts what a call from Python costs."""
    data = model.createData()

    def run() -> np.ndarray:
        for i in range(_BATCH):
            function(model, data, q[i], v[i], third[i])
        return q

    return Timed(run, _BATCH)


def _over(ours: Timed, model: Any, function: Any, *points: np.ndarray) -> float:
    """Our time over Pinocchio's, timed in turn. The time of a model of one link is subtracted from Pinocchio's."""
    small = pinocchio_model(chain_models.equal_links(1))
    call = _theirs(small, function, *(np.ascontiguousarray(values[:, :1]) for values in points))
    theirs = _theirs(model, function, *points)
    ours = dataclasses.replace(ours, samples=[])
    in_turn([ours, theirs, call], Repeats(15, 5, 2.0))
    return ours.seconds / (theirs.seconds - call.seconds)


def _agree(*pairs: tuple[Any, np.ndarray]) -> None:
    for ours, theirs in pairs:
        agree(float(np.max(np.abs(np.asarray(ours) - theirs)) / np.max(np.abs(theirs))), 1e-9)


def _ratio(robot: str, part: str) -> float:
    pin, (model, q, v, tau, order) = needed("pinocchio", "pin"), _pinocchio(robot)
    ours, data = _ours(robot, part)[0], model.createData()
    results, function = ours.call(), pin.aba if part == "dynamics" else pin.computeABADerivatives
    group, width = _mechanism(robot).system().group, _points(robot)[1]["tau"].shape[1]
    for i in range(0, _BATCH, _BATCH // 8):
        if part == "dynamics":
            pairs = [(results["qd"][i], pin.aba(model, data, q[i], v[i], tau[i])[order])]
        else:
            slopes = [a[np.ix_(order, order)] for a in pin.computeABADerivatives(model, data, q[i], v[i], tau[i])]
            slopes[2] = np.triu(slopes[2]) + np.triu(slopes[2], 1).T if np.tril(slopes[2], -1).any() else slopes[2]
            rates, places = group.slices["qd"], sorted(set(group.factors) - {"qd"}, key="q".__eq__)
            at = np.concatenate([np.arange(group.dimension)[group.slices[name]] for name in places])
            pairs = [(results["x"][i][rates, rates], slopes[1]), (results["x"][i][rates][:, at], slopes[0])]
            pairs.append((results["u"][i][rates], slopes[2][:, model.nv - width :]))
        _agree(*pairs)
    return _over(ours, model, function, q, v, tau)


def _rnea(links: int) -> float:
    """Our time over Pinocchio's for the derivatives of inverse dynamics of a chain of equal links."""
    pin, chain, n = needed("pinocchio", "pin"), chain_models.equal_links(links), links
    model = pinocchio_model(chain)
    q, qd, qdd = tx.Control("q", shape=(n,)), tx.State("qd", shape=(n,)), tx.Control("qdd", shape=(n,))
    known = inverse_dynamics_derivatives(chain, q, qd, qdd)
    system = tx.System(
        rates={qd: mechanics.inverse_dynamics(chain, q, qd, qdd)},
        slopes={qd: [(q, known.q), (qd, known.qd), (qdd, known.qdd)]},
    )
    dynamics = tx.compile(system, backend=tx.Native(threads=1))
    points = np.random.default_rng(3).normal(size=(3, _BATCH, n))
    call = lambda q, v, a: dynamics.jacobian(0.0, {"qd": v}, {"q": q, "qdd": a})  # noqa: E731
    timed = batch(call, *map(jnp.asarray, points))
    results, data = timed.call(), model.createData()
    by_q, by_v, _ = pin.computeRNEADerivatives(model, data, *points[:, 0])
    _agree((results["u"][0][:, :n], by_q), (results["x"][0], by_v))
    return _over(timed, model, pin.computeRNEADerivatives, *points)


def _operations(robot: str) -> float:
    mechanism = _mechanism(robot)
    q, qd, tau = (tx.State(name, shape=(mechanism.dofs,)) for name in ("q", "qd", "tau"))
    f = tx.lower(mechanics.forward_dynamics(mechanism, q, qd, tau))
    shapes = [jax.ShapeDtypeStruct((mechanism.dofs,), np.float64)] * 3
    return scalarize(lambda *a: [f(0.0, dict(zip(("q", "qd", "tau"), a, strict=True)))], *shapes).operations


def _row(what: str, by: str, limits: Sequence[float], measure: Any, part: str) -> list[MeasuredCase]:
    """A measurement for each limit: of the robots with files, then of 30 and 60 links."""
    unit = "s" if "compiling" in what else ""
    return [
        quick(f"{what}, {robot}", by, at_most(limit, unit), measure, robot, part, slow=limit > 1.0)
        for robot, limit in zip((*_ROBOTS, "30 links", "60 links"), limits, strict=False)
    ]


_seconds = lambda robot, part: _ours(robot, part)[1]  # noqa: E731

MECHANISMS: Section = [
    quick("operations of ABA, Panda", "mechanics.forward_dynamics", at_most(1450), _operations, "Panda"),
    *_row("compiling dynamics", "tx.Native", (0.4, 1.0, 2.5, 2.5, 4.0), _seconds, "dynamics"),
    *_row("compiling derivatives", "tx.Native", (2.0, 5.0, 12.0, 6.0, 12.0), _seconds, "derivatives"),
    *_row("dynamics of ABA, batch of 4,096", "over Pinocchio", (0.05, 0.1, 0.15), _ratio, "dynamics"),
    *_row("derivatives of ABA, batch of 4,096", "over Pinocchio", (0.1, 0.25, 0.5), _ratio, "derivatives"),
    slow("derivatives of RNEA, 30 links, batch of 4,096", "over Pinocchio", at_most(1.0), _rnea, 30),
]
