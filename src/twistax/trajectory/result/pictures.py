"""Plots of trajectories over time, with nodes, limits and multipliers; and animations in three dimensions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
from numpy import ndarray as Array

from ...errors import IntegrationError, TrajectoryError
from ...expr import Control, State
from ...jax_inside import in_double
from ...plots import Panel, chosen, draw, panels
from ...progress import watching
from ...system.labels import declared_labels

if TYPE_CHECKING:
    from ...view import Scene

#: The number of multipliers in a plot, of the constraints with the largest effect on the objective.
_MOST = 10


@watching("plot")
def drawn(
    parts: Sequence[Any],
    names: Sequence[Any],
    units: Mapping[str, str] | None,
    title: str = "",
    multipliers: Mapping[str, Array] | None = None,
) -> Any:
    """A figure of one trajectory, or of several consecutive ones; see `Trajectory.plot`."""
    # The original systems, in which linear controls and free node times have not become states.
    systems = [part.problem.phase.dynamics for part in parts]
    leaves: dict[str, Any] = {e.name: e for system in systems for e in (*system.states, *system.controls)}
    there = [name for name in leaves if any(name in part.xs or name in part.us for part in parts)]
    labels: dict[str, Any] = {}
    for dynamics in systems:
        labels |= declared_labels(dynamics.system) | dynamics.system.labels
    shown_panels = [
        panel
        for name in chosen(names, there, units) or there
        for panel in _panels(parts, leaves[name], (units or {}).get(name, ""), labels.get(name, ()))
    ]
    sizes = {name: float(np.abs(values).max()) for name, values in (multipliers or {}).items()}
    return draw(shown_panels, title, dict(list(sizes.items())[:_MOST]))


@watching("show")
def animated(parts: Sequence[Any], path: Any, choices: Mapping[str, Any]) -> Scene:
    """The scene of one trajectory, or of several consecutive ones; see `Trajectory.show`."""
    from ...view.motion import Motion, joined, shown

    motions = [_motion(part) for part in parts]
    ts, xs, us = zip(*motions)

    def outputs() -> dict[str, Array]:
        return joined([_outputs(part, *motion) for part, motion in zip(parts, motions, strict=True)])

    params = {name: value for part in parts for name, value in part.params.items()}
    return shown(Motion(np.concatenate(ts), joined(xs), (lambda: joined(us), outputs), params), path, **choices)


def _motion(part: Any) -> tuple[Array, Mapping[str, Array], Mapping[str, Array]]:
    """Times, states and controls of a dense rollout; those of the nodes if the rollout does not reach its end."""
    try:
        rollout = part.dense
    except (IntegrationError, TrajectoryError):
        count = len(part.ts)
        return part.ts, part.xs, {n: np.concatenate([us, us[-1:]])[:count] for n, us in part.us.items()}
    return rollout.ts, rollout.xs, rollout.us


def _outputs(part: Any, ts: Array, xs: Mapping[str, Array], us: Mapping[str, Array]) -> Mapping[str, Array]:
    """The outputs of the original system along a motion."""
    dynamics = part.problem.phase.dynamics
    params = {leaf.name: part.params[leaf.name] for leaf in dynamics.parameters if leaf.name in part.params}
    with in_double():
        outputs = jax.vmap(lambda t, x, u: dynamics.outputs(t, x, u, params))(ts, dict(xs), dict(us))
    return {name: np.asarray(value) for name, value in outputs.items()}


def _panels(parts: Sequence[Any], leaf: State | Control, unit: str, labels: Sequence[tuple[str, str]]) -> list[Panel]:
    """States: dots at nodes, and the line of a rollout. Controls: as interpolated between nodes."""
    marks, curves, is_held = [], [], False
    for part in parts:
        values = part.xs.get(leaf.name, part.us.get(leaf.name))
        if values is None:
            continue
        marks.append((part.ts[: len(values)], values))
        if leaf.name in part.us:
            is_held = len(values) < len(part.ts)
            curves.append((part.ts, np.concatenate([values, values[-1:]]) if is_held else values))
        else:
            curves += _rollout(part, leaf.name)
    group = leaf.group if isinstance(leaf, State) else None
    dots, lines = (panels(leaf.name, group, pieces, unit, labels) for pieces in (marks, curves))
    return [
        dot._replace(
            marks=dot.curve, curve=lines[i].curve if curves else None, steps=is_held, limits=_limits(leaf, dot)
        )
        for i, dot in enumerate(dots)
    ]


def _limits(leaf: State | Control, panel: Panel) -> list[float]:
    """The finite bounds of the entries in a panel, in its unit."""
    bounds = set[float]()
    for side in (leaf.min, leaf.max):
        if side is not None:
            values = np.broadcast_to(np.asarray(side, float), leaf.shape).reshape(-1)
            bounds |= set((panel.factor * (values if panel.columns is None else values[list(panel.columns)])).tolist())
    return sorted(bound for bound in bounds if np.isfinite(bound))


def _rollout(part: Any, name: str) -> list[tuple[Array, Array]]:
    """A state along a dense rollout of the controls, if that reaches its end."""
    try:
        rollout = part.dense
    except (IntegrationError, TrajectoryError):
        return []
    return [(rollout.ts, rollout.xs[name])]
