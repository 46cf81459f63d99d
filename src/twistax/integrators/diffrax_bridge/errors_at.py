"""Errors of a step as diffrax wants them, of the form of the state, and read back as tangents."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax

from ...groups import Euclidean, SpecialEuclidean, so3
from ...groups.components import unpack, vector
from ...lowering.dynamics import Arrays
from ..ambient import Ambient
from ..charts.whole import Blocks, StateCoordinates

__all__ = ["deviations_in", "errors_at"]


def errors_at(ambient: Ambient, local: StateCoordinates, x: Arrays, deviations: Blocks) -> Arrays:
    """The change of the entries of x under small tangents: [R W, R v; 0 0] for a pose and a deviation [v; w].

    Args:
        ambient: the system in matrices.
        deviations: as `Coordinates.deviation` gives them.
    """
    velocities: dict[str, Any] = {}
    for name, group in ambient.dynamics.group.factors.items():
        if isinstance(group, Euclidean):
            velocities[name] = local.parts[name].value(deviations[name])
        else:
            tangent = vector(deviations[name])
            velocities[name] = (
                group.order.from_linear_first(tangent) if isinstance(group, SpecialEuclidean) else tangent
            )
    return ambient.rates(x, velocities)


def deviations_in(ambient: Ambient, local: StateCoordinates, x: Mapping[str, Any], errors: Mapping[str, Any]) -> Blocks:
    """The deviations again, from what `errors_at` made of them."""
    found: Blocks = {}
    for name, group in ambient.dynamics.group.factors.items():
        if isinstance(group, Euclidean):
            found[name] = local.parts[name].enter(errors[name])
        elif isinstance(group, SpecialEuclidean):
            back = x[name][:3, :3].T
            found[name] = (*unpack(so3.act(back, errors[name][:3, 3])), *_turn(back, errors[name][:3, :3]))
        else:
            found[name] = _turn(x[name].T, errors[name])
    return found


def _turn(back: jax.Array, error: jax.Array) -> tuple[jax.Array, ...]:
    return unpack(so3.vee(so3.compose(back, error)))
