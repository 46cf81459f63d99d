"""Calls of a controller for the test of its C code; the controller's state is restored afterwards."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray as Array

from ...jax_inside import in_double
from .log import ControllerLog


class Rehearsed(NamedTuple):
    """The results of calls, a row each: z, the multipliers of the dynamics, iterations and statuses."""

    plans: Array
    multipliers: Array
    iterations: Array
    statuses: Array


def drawn_states(controller: Any, count: int = 5) -> list[dict[str, Array]]:
    """Random states near the nodes of the plan."""
    group, nodes = controller.part.phase.dynamics.group, controller.phases[0].xs
    rng, units = np.random.default_rng(0), np.asarray(controller.units.size)[: group.dimension]
    states = []
    for k in range(min(count, controller.part.nodes)):
        node, step = {name: values[k] for name, values in nodes.items()}, 0.05 * rng.normal(size=len(units))
        with in_double():
            moved = group.retract(node, step * units)
        states.append({name: np.asarray(value) for name, value in moved.items()})
    return states


def rehearsed(controller: Any, states: Sequence[Mapping[str, Any]]) -> Rehearsed:
    """The results of calls, each followed by a shift if the plan can be shifted; the controller's
    state is restored afterwards.
    """
    kept, log, status = controller.prepared.saved(), controller.log, controller.status
    controller.log = ControllerLog(len(states))
    plans, multipliers, counts = [], [], []
    with controller.constant_units():
        for x in states:
            controller.feedback(x)
            plans.append(controller.prepared.z.copy())
            multipliers.append(controller.prepared.lam.copy())
            counts.append([controller.prepared.measure("iterations"), controller.prepared.measure("status")])
            if controller.moves_on is not None:
                controller.shift()
    controller.prepared.load(kept)
    controller.log, controller.status = log, status
    iterations, statuses = np.array(counts, np.int32).T
    return Rehearsed(
        np.array(plans), np.array(multipliers), np.ascontiguousarray(iterations), np.ascontiguousarray(statuses)
    )
