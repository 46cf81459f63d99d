"""Calls of a controller for the test of its C code; the controller's state is restored afterwards."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy import ndarray as Array

from ...jax_inside import in_double
from .log import ControllerLog


def drawn_states(controller: Any, count: int = 5) -> list[dict[str, Array]]:
    """Random states near the nodes of the plan."""
    rng, group, nodes = np.random.default_rng(0), controller.part.dynamics.group, controller.xs
    units = np.asarray(controller.units.size)[: controller.part.shooting.n]
    states = []
    for k in range(min(count, controller.part.nodes)):
        node, step = {name: values[k] for name, values in nodes.items()}, 0.05 * rng.normal(size=len(units))
        with in_double():
            moved = group.retract(node, step * units)
        states.append({name: np.asarray(value) for name, value in moved.items()})
    return states


def rehearsed(controller: Any, states: Sequence[Mapping[str, Any]]) -> tuple[Array, Array, Array]:
    """Points, iterations and statuses of calls, each followed by a shift; the controller's state is restored
    afterwards.
    """
    kept, log, status = controller.prepared.saved(), controller.log, controller.status
    controller.log = ControllerLog(len(states))
    points, counts = [], []
    with controller.constant_units():
        for x in states:
            controller.feedback(x)
            points.append(controller.prepared.z.copy())
            counts.append([controller.prepared.measure("iterations"), controller.prepared.measure("status")])
            controller.shift()
    controller.prepared.load(kept)
    controller.log, controller.status = log, status
    iterations, statuses = np.array(counts, np.int32).T
    return np.array(points), np.ascontiguousarray(iterations), np.ascontiguousarray(statuses)
