"""A mechanism as a system: its states on their groups, its motors as controls, its limits as bounds."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any

from ..checks import callable_with, listed
from ..errors import ModelError
from ..expr import Concat, Constant, Expr, State
from ..expr.fields import ExprLike
from ..expr.operations.soft import Asked
from ..expr.transformations.rate import rates_by_name
from ..system import System
from .algorithms.closed_loops import ClosedLoops
from .algorithms.dynamics import Wrenches
from .algorithms.forward_dynamics import forward_dynamics
from .algorithms.system_slopes import slopes_of_accelerations
from .kinematic_tree import KinematicTree
from .labels import labels_of


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
    tau = passive_forces(mechanism, places)
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
    slopes = None if mechanism.loops else slopes_of_accelerations(mechanism, total, wrenches)
    if mechanism.loops:
        moved, sped = ClosedLoops(mechanism).corrections
        corrections = {**kinematics(mechanism, places, moved), mechanism.qd: sped}
    motion: dict[Any, ExprLike] = {**kinematics(mechanism, places, mechanism.qd), mechanism.qd: accelerations}
    twice = [state.name for state in motion if state.name in further]
    if twice:
        raise ModelError(
            f"system expects rates of further states, got {listed(twice)}, the motion of the mechanism itself.\n"
            "  fix: put what acts on it into forces or wrenches"
        )
    return System(
        rates={**motion, **(rates or {})},
        outputs=outputs,
        constraints=constraints,
        corrections=corrections,
        slopes={mechanism.qd: slopes} if slopes else None,
        labels=labels_of(mechanism, driven if command is not None else []),
    )


def passive_forces(mechanism: KinematicTree, places: list[Expr]) -> list[Expr]:
    """The force of springs, damping and friction on each freedom, N or N m."""
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
    """The rates of all positions at velocities (n,)."""
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
