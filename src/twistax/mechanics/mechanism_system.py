"""A mechanism as a system: with motors as controls and limits as bounds, or with accelerations as controls and torques
as constraints.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any

import numpy as np

from ..checks import callable_with, instance, listed
from ..errors import ModelError
from ..expr import Concat, Constant, Control, Expr, State, to_expr
from ..expr.fields import ExprLike
from ..expr.operations.soft import Asked
from ..expr.transformations.rate import rates_by_name
from ..progress import watching
from ..system import System
from ..system.declared import Slopes, SlopesOnDemand
from ..system.system import constraints_by_name
from .algorithms.closed_loops import ClosedLoops
from .algorithms.dynamics import Wrenches, inverse_dynamics
from .algorithms.forward_dynamics import forward_dynamics
from .algorithms.system_slopes import moves_itself, scalars_of_slopes, slopes_of_accelerations
from .kinematic_tree import KinematicTree
from .labels import labels_of
from .tree import Segment


@watching("system")
def system_of(
    mechanism: KinematicTree,
    controls: Collection[str] | None,
    forces: ExprLike | None,
    wrenches: Wrenches | None,
    rates: Mapping[State | str, ExprLike] | None,
    outputs: Mapping[str, ExprLike] | Callable[[Expr, Expr], Mapping[str, ExprLike]] | None,
    constraints: Asked | Iterable[Asked] | Mapping[str, Asked],
) -> System:
    """Implements `Mechanism.system`."""
    if not mechanism.dofs:
        raise ModelError("system expects a mechanism with a joint that moves, got none")
    further = rates_by_name(rates or {})
    controls = mechanism.driven if controls is None else controls
    driven = mechanism.freedoms(controls)
    command = mechanism.motors(controls) if driven else None
    places = mechanism.positions("system", None)
    tau = _passive_forces(mechanism, places)
    for segment in mechanism.segments:
        for i in segment.freedoms:
            if command is not None and segment.link.mimic is None and i in driven:
                tau[i] = tau[i] + segment.link.drive.gear * command[driven.index(i)]
    total: Expr = Concat(*tau)
    if forces is not None:
        total = total + mechanism.coordinates("system", "forces", forces)
    accelerations = forward_dynamics(mechanism, tau=total, wrenches=wrenches)
    if callable(outputs):
        callable_with("system: outputs", outputs, ["qdd", "tau"], ModelError)
        outputs = outputs(accelerations, total)
    corrections: dict[Any, Expr] = {}
    if mechanism.loops:
        moved, sped = ClosedLoops(mechanism).corrections
        corrections = {**kinematics(mechanism, places, moved), mechanism.qd: sped}
    motion: dict[Any, ExprLike] = {**kinematics(mechanism, places, mechanism.qd), mechanism.qd: accelerations}
    twice = [state.name for state in motion if state.name in further]
    if twice:
        raise ModelError(
            f"system expects rates of additional states, got {listed(twice)}, which the mechanism determines.\n"
            "  fix: pass forces in forces= or wrenches="
        )

    def slopes(rates: Mapping[str, Expr]) -> Slopes:
        qdd = rates[mechanism.qd.name]
        return {mechanism.qd: slopes_of_accelerations(mechanism, qdd, total, wrenches)}

    known = not mechanism.loops and not moves_itself(mechanism)
    return System(
        rates={**motion, **(rates or {})},
        outputs=outputs,
        constraints=constraints,
        corrections=corrections,
        slopes=SlopesOnDemand(slopes, scalars_of_slopes(mechanism)) if known else None,
        labels=labels_of(mechanism, driven if command is not None else []),
    )


def _passive_forces(mechanism: KinematicTree, places: list[Expr]) -> list[Expr]:
    """The force of springs, damping and friction on each degree of freedom, N or N m."""
    tau: list[Expr] = [Constant(0.0)] * mechanism.dofs
    for segment, place in zip(mechanism.segments, places, strict=True):
        drive, deflection = segment.link.drive, segment.link.joint.deflection(place)
        for k, i in enumerate(segment.freedoms):
            rate = segment.scaled(mechanism.qd[i])
            passive = drive.passive(None if deflection is None else deflection[k], rate)
            if passive is not None:
                tau[i] = tau[i] + segment.scaled(passive)
    return tau


def kinematics(mechanism: KinematicTree, places: list[Expr], qd: Expr) -> dict[Any, Expr]:
    """The rates of all positions for velocities (n,)."""
    q = mechanism.q
    vector = q if isinstance(q, State) else q.get("q")
    group_rates: dict[Any, Expr] = {}
    rows: list[Expr] = []
    for segment, place in zip(mechanism.segments, places, strict=True):
        if segment.link.mimic is not None or not segment.freedoms:
            continue
        joint_rate = qd[segment.freedoms[0] : segment.freedoms[-1] + 1]
        if segment.link.joint.group is None:
            rows.append(segment.link.joint.rate(place, joint_rate))
        else:
            group_rates[place] = segment.link.joint.rate(place, joint_rate)
    return {vector: Concat(*rows), **group_rates} if rows else group_rates


# ---- by inverse dynamics ---------------------------------------------------------------------------------------------

#: Names that the system adds, which users cannot use.
_COMMAND, _LEAST, _MOST, _FREE = "tau", "tau at least", "tau at most", "freedoms without motors"


@watching("system")
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
            "inverse_system expects a tree, got a mechanism with loops, whose wrenches are not determined.\n"
            "  fix: use system(), or remove the loops and pass their forces as controls in wrenches="
        )
    qdd = Control("qdd", (mechanism.dofs,))
    places = mechanism.positions("inverse_system", None)
    total = inverse_dynamics(mechanism, qdd=qdd, wrenches=wrenches)
    if outputs is not None and not callable(outputs):
        instance("inverse_system: outputs", outputs, Mapping, "expressions by name, or a function", ModelError)
    left = total - Concat(*_passive_forces(mechanism, places))
    if forces is not None:
        left = left - mechanism.coordinates("inverse_system", "forces", forces)
    joints = mechanism.driven if controls is None else controls
    driven = mechanism.freedoms(joints)
    rows: dict[str, Asked] = {}
    shown: dict[str, ExprLike] = {}
    if driven:
        motors, gears = mechanism.motors(joints), _gears(mechanism)
        without = [mechanism.joints[i] for i, s in enumerate(mechanism.segments) if _ungeared(s, driven)]
        if without:
            raise ModelError(
                f"inverse_system: the motors of {listed(without)} have a gear of zero, so their force does "
                "not depend on a command.\n  fix: leave them out of controls=[...]"
            )
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
            raise ModelError(
                f"inverse_system: {kind} names {listed(twice)}, which the system adds itself.\n  fix: rename it"
            )
    labels = labels_of(mechanism, [])
    labels["qdd"] = [(name, f"{unit}2" if unit.endswith("/s") else unit) for name, unit in labels["qd"]]
    motion: dict[Any, ExprLike] = {**kinematics(mechanism, places, mechanism.qd), mechanism.qd: qdd}
    return System(rates=motion, outputs={**shown, **(outputs or {})}, constraints={**rows, **further}, labels=labels)


def _ungeared(segment: Segment, driven: list[int]) -> bool:
    """Whether a motor has the gear zero."""
    gear = to_expr(segment.link.drive.gear)
    moved = segment.link.mimic is None and any(i in driven for i in segment.freedoms)
    return moved and isinstance(gear, Constant) and not np.any(gear.value)


def _gears(mechanism: KinematicTree) -> dict[int, ExprLike]:
    """The joint force per unit of command for every degree of freedom, of its joint without those that mimic it."""
    segments = [segment for segment in mechanism.segments if segment.link.mimic is None]
    return {i: segment.link.drive.gear for segment in segments for i in segment.freedoms}
