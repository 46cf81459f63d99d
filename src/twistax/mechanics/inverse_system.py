"""A mechanism as a system whose controls are accelerations: what motors must do is computed, and limited."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any

import numpy as np

from ..checks import callable_with, listed
from ..errors import ModelError
from ..expr import Concat, Control, Expr
from ..expr.fields import ExprLike
from ..expr.operations.soft import Asked
from ..system import System
from ..system.system import constraints_by_name
from .algorithms.dynamics import Wrenches, inverse_dynamics
from .kinematic_tree import KinematicTree
from .labels import labels_of
from .mechanism_system import kinematics, passive_forces

#: The names of what is added to a system, which its user may not take.
_COMMAND, _LEAST, _MOST, _FREE = "tau", "tau at least", "tau at most", "freedoms without motors"


def inverse_system_of(
    mechanism: KinematicTree,
    controls: Collection[str] | None,
    forces: ExprLike | None,
    wrenches: Wrenches | None,
    outputs: Mapping[str, ExprLike] | Callable[[Expr, Expr], Mapping[str, ExprLike]] | None,
    constraints: Asked | Iterable[Asked] | Mapping[str, Asked],
) -> System:
    """Implements `Mechanism.inverse_system`."""
    if not mechanism.dofs:
        raise ModelError("inverse_system expects a mechanism with a joint that moves, got none")
    if mechanism.loops:
        raise ModelError(
            "inverse_system expects a tree, got a mechanism with loops, whose wrenches nothing fixes.\n"
            "  fix: take system(), or cut the loops and give their forces as controls by wrenches="
        )
    qdd = Control("qdd", (mechanism.dofs,))
    places = mechanism.positions("inverse_system", None)
    total = inverse_dynamics(mechanism, qdd=qdd, wrenches=wrenches)
    left = total - Concat(*passive_forces(mechanism, places))
    if forces is not None:
        left = left - mechanism.coordinates("inverse_system", "forces", forces)
    joints = mechanism.driven if controls is None else controls
    driven = mechanism.freedoms(joints)
    rows: dict[str, Asked] = {}
    shown: dict[str, ExprLike] = {}
    if driven:
        motors, gears = mechanism.motors(joints), _gears(mechanism)
        command = Concat(*(left[i] / gears[i] for i in driven))
        shown[_COMMAND] = command
        for name, limits, sign in ((_LEAST, motors.min, -1.0), (_MOST, motors.max, 1.0)):
            limited = [] if limits is None else np.flatnonzero(np.isfinite(limits)).tolist()
            if limits is not None and limited:
                rows[name] = Concat(*(sign * command[k] for k in limited)) <= sign * limits[limited]
    if free := [i for i in range(mechanism.dofs) if i not in driven]:
        rows[_FREE] = Concat(*(left[i] for i in free)) == np.zeros(len(free))
    if callable(outputs):
        callable_with("inverse_system: outputs", outputs, ["qdd", "tau"], ModelError)
        outputs = outputs(qdd, total)
    further = constraints_by_name(constraints)
    for kind, names, taken in (("outputs", outputs or {}, shown), ("constraints", further, rows)):
        if twice := [name for name in names if name in taken]:
            raise ModelError(f"inverse_system: {kind} names {listed(twice)}, which it adds itself.\n  fix: rename it")
    labels = labels_of(mechanism, [])
    labels["qdd"] = [(name, f"{unit}2" if unit.endswith("/s") else unit) for name, unit in labels["qd"]]
    motion: dict[Any, ExprLike] = {**kinematics(mechanism, places, mechanism.qd), mechanism.qd: qdd}
    return System(rates=motion, outputs={**shown, **(outputs or {})}, constraints={**rows, **further}, labels=labels)


def _gears(mechanism: KinematicTree) -> dict[int, ExprLike]:
    """The joint force per unit of command of every freedom, of its joint and not of those that mimic it."""
    segments = [segment for segment in mechanism.segments if segment.link.mimic is None]
    return {i: segment.link.drive.gear for segment in segments for i in segment.freedoms}
