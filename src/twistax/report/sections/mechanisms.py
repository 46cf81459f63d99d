"""Robots from their files: operations, seconds to compile, and times beside Pinocchio, which is agreed with first."""

from __future__ import annotations

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

from ... import mechanics
from ...mechanics import Drive, Mechanism, chain_models
from ...mechanics.derivatives import inverse_dynamics_derivatives
from ...scalar.reader import scalarize
from ..checks import Absent, Check, Section, agree, at_most, needed, slow
from ..speed.contenders import pinocchio_model
from ..timing import Repeats, Timed, batch, in_turn

_BATCH = 4096
_REPEATS = Repeats(15, 5, 2.0)
_DATA = "cmeel.prefix/share/example-robot-data/robots"
#: Where the files are beside the packages, and whether the root link floats.
_FILES = {
    "Panda": ("frax/assets/franka_panda/panda.urdf", False),
    "ANYmal": (f"{_DATA}/anymal_b_simple_description/robots/anymal.urdf", True),
    "Talos": (f"{_DATA}/talos_data/robots/talos_reduced.urdf", True),
}


def _file(robot: str) -> tuple[Path, bool]:
    name, floating = _FILES[robot]
    spec = importlib.util.find_spec("pinocchio")
    for parent in Path(spec.origin).parents if spec and spec.origin else ():
        if (parent / name).exists():
            return parent / name, floating
    raise Absent(f"{name} is not installed")


@functools.cache
def _mechanism(robot: str) -> Mechanism:
    """Without what Pinocchio leaves out: damping and friction."""
    if robot not in _FILES:
        return chain_models.equal_links(int(robot.split()[0]))
    path, floating = _file(robot)
    read = mechanics.load(path, floating=floating, physical=False)
    return Mechanism([dataclasses.replace(link, drive=Drive()) for link in read.links], read.gravity)


@functools.cache
def _points(robot: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """States and controls of a batch."""
    system, rng = _mechanism(robot).system(), np.random.default_rng(20240611)
    x = {state.name: jnp.asarray(rng.normal(size=(_BATCH, *state.shape))) for state in system.states}
    if "root_position" in x:
        x["root_position"] = jax.vmap(tx.SE3.exp)(jnp.asarray(rng.normal(size=(_BATCH, 6))))
    return x, {"tau": jnp.asarray(rng.normal(size=(_BATCH, *system.controls[0].shape)))}


@functools.cache
def _ours(robot: str, part: str) -> tuple[Timed, float]:
    """The batch of a robot by one thread, and the processor's seconds from the expression on."""
    system, (x, u) = _mechanism(robot).system(), _points(robot)
    begin = time.process_time()
    dynamics = tx.compile(system, backend=tx.Native(threads=1))
    before = time.process_time() - begin
    function = dynamics if part == "dynamics" else dynamics.jacobian
    timed = batch(lambda x, u: function(0.0, x, u), x, u)
    return timed, timed.compile_seconds + before


@functools.cache
def _pinocchio(robot: str) -> tuple[Any, np.ndarray, np.ndarray, np.ndarray, list[int]]:
    """Its model, positions, velocities and forces of the batch, and its entries of our velocities."""
    pin, (path, floating) = needed("pinocchio", "pin"), _file(robot)
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
        own = np.asarray(x["q"])[:, segment.coordinates]
        own = own if joint.nq == 1 else np.concatenate([np.cos(own), np.sin(own)], axis=1)
        q[:, joint.idx_q : joint.idx_q + joint.nq] = own
    v, tau = np.zeros((2, _BATCH, model.nv))
    v[:, order], tau[:, order[model.nv - u["tau"].shape[1] :]] = x["qd"], u["tau"]
    return model, q, v, tau, order


def _theirs(model: Any, function: Any, q: np.ndarray, v: np.ndarray, third: np.ndarray) -> Timed:
    """Point by point. What a call from Python costs is taken off by `_beside`."""
    data = model.createData()

    def run() -> np.ndarray:
        for i in range(_BATCH):
            function(model, data, q[i], v[i], third[i])
        return q

    return Timed(run, _BATCH)


def _beside(own: Timed, model: Any, function: Any, *points: np.ndarray) -> float:
    """The time of ours over Pinocchio's, in turn. From theirs the time of a model of one link is taken off."""
    small = pinocchio_model(chain_models.equal_links(1))
    call = _theirs(small, function, *(np.ascontiguousarray(each[:, :1]) for each in points))
    other = _theirs(model, function, *points)
    own = dataclasses.replace(own, samples=[])
    in_turn([own, other, call], _REPEATS)
    return own.seconds / (other.seconds - call.seconds)


def _agree(*pairs: tuple[Any, np.ndarray]) -> None:
    for ours, theirs in pairs:
        agree(float(np.max(np.abs(np.asarray(ours) - theirs)) / np.max(np.abs(theirs))), 1e-9)


def _ratio(robot: str, part: str) -> float:
    pin, (model, q, v, tau, order) = needed("pinocchio", "pin"), _pinocchio(robot)
    own, data = _ours(robot, part)[0], model.createData()
    found, function = own.call(), pin.aba if part == "dynamics" else pin.computeABADerivatives
    group, width = _mechanism(robot).system().group, _points(robot)[1]["tau"].shape[1]
    for i in range(0, _BATCH, _BATCH // 8):
        if part == "dynamics":
            pairs = [(found["qd"][i], pin.aba(model, data, q[i], v[i], tau[i])[order])]
        else:
            slopes = [a[np.ix_(order, order)] for a in pin.computeABADerivatives(model, data, q[i], v[i], tau[i])]
            slopes[2] = np.triu(slopes[2]) + np.triu(slopes[2], 1).T if np.tril(slopes[2], -1).any() else slopes[2]
            rates, places = group.slices["qd"], sorted(set(group.factors) - {"qd"}, key="q".__eq__)
            at = np.concatenate([np.arange(group.dimension)[group.slices[name]] for name in places])
            pairs = [(found["x"][i][rates, rates], slopes[1]), (found["x"][i][rates][:, at], slopes[0])]
            pairs.append((found["u"][i][rates], slopes[2][:, model.nv - width :]))
        _agree(*pairs)
    return _beside(own, model, function, q, v, tau)


def _rnea(links: int) -> float:
    """The derivatives of inverse dynamics of a chain of equal links."""
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
    found, data = timed.call(), model.createData()
    by_q, by_v, _ = pin.computeRNEADerivatives(model, data, *points[:, 0])
    _agree((found["u"][0][:, :n], by_q), (found["x"][0], by_v))
    return _beside(timed, model, pin.computeRNEADerivatives, *points)


def _operations(robot: str) -> float:
    """Of the forward dynamics."""
    mechanism = _mechanism(robot)
    q, qd, tau = (tx.State(name, shape=(mechanism.dofs,)) for name in ("q", "qd", "tau"))
    f = tx.lower(mechanics.forward_dynamics(mechanism, q, qd, tau))
    shapes = [jax.ShapeDtypeStruct((mechanism.dofs,), np.float64)] * 3
    return scalarize(lambda *a: [f(0.0, dict(zip(("q", "qd", "tau"), a, strict=True)))], *shapes).operations


def _row(what: str, by: str, limits: Sequence[float], measure: Any, part: str) -> list[Check]:
    """One check a limit, of the robots with files and then of 60 links."""
    unit = "s" if "compiling" in what else ""
    return [
        Check(f"{what}, {robot}", by, at_most(limit, unit), measure, robot, part, slow=limit > 1.0)
        for robot, limit in zip((*_FILES, "60 links"), limits, strict=False)
    ]


_SECONDS = {"dynamics": (0.4, 1.0, 2.5, 4.0), "derivatives": (2.0, 5.0, 12.0, 20.0)}
_OVER = {"dynamics": (0.05, 0.1, 0.15), "derivatives": (0.1, 0.25, 0.5)}

MECHANISMS: Section = [
    Check("operations of ABA, Panda", "mechanics.forward_dynamics", at_most(1450), lambda: _operations("Panda")),
    *(
        check
        for part, limits in _SECONDS.items()
        for check in _row(f"compiling {part}", "tx.Native", limits, lambda *which: _ours(*which)[1], part)
    ),
    *(
        check
        for part, limits in _OVER.items()
        for check in _row(f"{part} of ABA, batch of 4,096", "over Pinocchio", limits, _ratio, part)
    ),
    slow("derivatives of RNEA, 30 links, batch of 4,096", "over Pinocchio", at_most(1.0), _rnea, 30),
]
