"""A phase of a problem in the form that the transcription takes."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Mapping
from typing import Any

import jax
import numpy as np
from numpy import ndarray as Array

from ...checks import short
from ...errors import ModelError, TrajectoryError
from ...expr import Control, Parameter, State, leaves_of
from ...system import entry_names, name_of
from ..border import Border, boxes_of, times_of
from ..hessians import checked_hessian
from ..mesh import mesh_of
from ..shooting import Shooting
from ..transcribed import Point
from ..transcription import transcription_of
from ..warm import other_problem
from .bridges.continuous import Restated
from .bridges.functionals import InPhase, Reduction
from .bridges.norms import above, bounds_along, norm_controls
from .bridges.soft import NodeSlacks, check_weights, slack_controls
from .by_node import ByNode
from .conditions import Conditions, Ends, at_nodes, conditions, ends_of, split, stated_values
from .controls import continuous_controls
from .guess import control_guess, state_guess, user_guess
from .phase import Phase
from .statement import Objective, check_leaves, describe_path

#: A control of less than this share of its size says nothing of it.
_NOTHING = 1e-4


class StatedPhase:
    """A phase whose bridges have been applied: no functionals, soft constraints or continuous controls are left.

    Args:
        phase: as stated.
        objective: what it adds to the objective.
        within: what it knows of its problem.

    Attributes:
        phase: as stated.
        dynamics, objective: with what the bridges added.
        softened, reduced, restated, norms: the bridges, in the order in which they are applied.
        path: the rows along the path.
        shooting: its transcription.
        border: the unknowns that all phases share.
        number: which phase it is.
        bounds: parameters that the bridges added.
        parameters: those of the system and those that only the problem reads, by name.
        readable: those of them that the problem reads.
    """

    path: Any
    shooting: Shooting
    border: Border

    def __init__(self, phase: Phase, objective: Objective, within: InPhase) -> None:
        self.phase = phase
        self.mesh, self.number = mesh_of(phase.nodes), 0
        self.nodes = self.mesh.nodes
        self.time_limits, self.time_guess = times_of(phase.final_time, phase.final_time_guess)
        self.transcription = transcription_of(phase.transcription, phase.method, phase.substeps)
        self.hessian = checked_hessian(phase.hessian)
        (first, at_first), (last, at_last) = split("initial", phase.initial), split("final", phase.final)
        inner = at_nodes(phase.at, self.nodes)
        self._bridge(objective, {0: at_first, self.nodes - 1: at_last, **inner}, within)
        dynamics = self.dynamics
        for place, expr in (("the objective", self.objective.final), ("the running cost", self.objective.running)):
            if expr is not None:
                check_leaves(dynamics, place, expr, controls=expr is self.objective.running)
        self.ends = ends_of(dynamics.states, first, last, (within.first, within.last))
        self._leaves: dict[str, State | Control] = {leaf.name: leaf for leaf in (*dynamics.states, *dynamics.controls)}
        self._lengths = {name: self.nodes - isinstance(leaf, Control) for name, leaf in self._leaves.items()}
        self._read_parameters()

    def _bridge(self, objective: Objective, asked: Mapping[int, Any], within: InPhase) -> None:
        """Apply the bridges in turn, and state the conditions at nodes by what they made of them."""
        phase, last = self.phase, self.nodes - 1
        places = {0: "initial", last: "final"}
        named = {places.get(k, f"node {k}"): rows for k, rows in asked.items()}
        softened = self.softened = NodeSlacks(objective, named, f"{within.name}: " if within.name else "")
        first_rows, last_rows, *inner_rows = softened.plain.values()
        smooth = continuous_controls(phase.controls, phase.dynamics.controls)
        reduced = Reduction(phase.dynamics, softened.objective, first_rows, last_rows, inner_rows, within, smooth)
        self.reduced = reduced
        controls = reduced.shapes_of_bounds(phase.controls)
        restated = self.restated = Restated(
            reduced.dynamics, reduced.objective, controls, self.mesh, within.first, added=reduced.bounds
        )
        self.dynamics, self.objective = restated.dynamics, restated.objective
        norms = norm_controls(self.objective.running, self.objective.sign)
        self.norms = slack_controls(norms, restated, phase.dynamics.system.soft)
        rows = {k: restated.plain(reduced.plain(own)) for k, own in zip(list(asked)[2:], inner_rows)}
        rows[0] = restated.plain(first_rows | reduced.at_start)
        self._at_ends = rows[0], restated.plain(reduced.plain(last_rows), last=True)
        #: Conditions at nodes before the last, and at the last.
        self.node_rows = {k: conditions(self.dynamics, places.get(k, f"node {k}"), own) for k, own in rows.items()}
        if not rows[0]:
            del self.node_rows[0]
        last_rows = restated.plain(reduced.plain(last_rows) | restated.at_end, last=True)
        self.final_rows = conditions(self.dynamics, "final", last_rows)

    def _read_parameters(self) -> None:
        """Which parameters there are, and which of them the problem reads."""
        at_nodes = [row for rows in (self.final_rows, *self.node_rows.values()) for row in rows.residuals]
        priced = [e for e in (self.objective.final, self.norms.running) if e is not None]
        running = [] if self.objective.running is None else [self.objective.running]
        leaves = list(leaves_of(*priced, *running, *at_nodes))
        known = {leaf.name: leaf for leaf in self.dynamics.parameters}
        added = {e.name: e for e in leaves if isinstance(e, Parameter) and e.name not in known}
        self.parameters = known | added
        reads = self.dynamics._functions.reads
        of_system = reads["rates"] | reads["constraints"]
        seen = of_system | {leaf.name for leaf in leaves}
        self.readable = [*(leaf for leaf in known.values() if leaf.name in seen), *added.values()]
        self.baked = {leaf.name for leaf in self.dynamics.system.parameters} - set(known)
        self.by_node = ByNode.of(self.phase.by_node, self.mesh.shares)
        self.bounds = boxes_of({**self.reduced.free, **self.softened.free}, self.readable, ())
        elsewhere = [*at_nodes, *(row for _, row in self.norms.rows)]
        self._check_by_node = functools.partial(self.by_node.check, priced, elsewhere, of_system)

    def transcribe(self, number: int, border: Border) -> None:
        """Make it a phase of a problem with these durations and free parameters: what compiles."""
        self.number, self.border = number, border
        free = {box.name for box in border.boxes}
        self._check_by_node(free)
        self.own_guess = user_guess(self.phase.guess, self._guessed, self._lengths)
        self.path = describe_path(self.dynamics, self.norms, free, self.restated.straight)
        self.shooting = Shooting(
            self.dynamics,
            self.objective,
            transcription=self.transcription,
            mesh=self.mesh,
            path=self.path,
            norms=self.norms,
            ends=self.ends,
            final=self.final_rows,
            at_nodes=self.node_rows,
            border=border,
            phase=number,
            pace=self.restated.pace,
            by_node=self.by_node,
        )
        self.squares = None if self.hessian is None else self.hessian.squares(self.shooting)
        self.shooting.alike = {name: state.name for name, state in self.reduced.starts.items()}
        self.advanced = jax.jit(self.shooting.advanced)

    def __getstate__(self) -> dict[str, Any]:
        """Without what compiles anew in another process."""
        return {k: v for k, v in self.__dict__.items() if k not in ("shooting", "advanced")}

    def __repr__(self) -> str:
        low, high = self.time_limits
        times = f"{low:g} s" if low == high else f"{low:g} to {high:g} s"
        return f"{self.phase.objective}, {self.nodes} nodes, {times}, {self.phase.dynamics}"

    @property
    def bounded(self) -> bool:
        """Whether bridges added bounds of norms or magnitudes, or extremes."""
        return bool(self.norms.controls or self.reduced.bounds or self.reduced.extremes or self.restated.bounds)

    @property
    def conditions(self) -> dict[int, Conditions]:
        """The conditions at nodes by number."""
        return {**self.node_rows, self.nodes - 1: self.final_rows}

    @property
    def soft(self) -> set[str]:
        """The names of soft constraints, entry by entry."""
        along = self.norms.soft.items()
        return {row for name, own in along for row in entry_names(name, own.constraint.shape)} | self.softened.rows

    @property
    def order(self) -> int:
        """Of the derivatives that are compiled."""
        return 2 if self.hessian is None else 1

    def check_weights(self, params: Mapping[str, Array]) -> None:
        """Raise InputError where parameters make the weight of a soft constraint negative."""
        at_nodes = {name: slack.soft for name, slack in self.softened.slacks.items()}
        check_weights({**self.norms.soft, **at_nodes}, params)

    def shown_rows(self, ts: Array, xs: Mapping[str, Any], us: Mapping[str, Any], params: Mapping[str, Any]) -> Array:
        """(points, rows) the path rows as users wrote them, at many points."""
        local = self.shooting.local
        return local.along(local.expressions.shown, ts, xs, us, params)

    def path_rows(self, ts: Array, xs: Mapping[str, Any], us: Mapping[str, Any], params: Mapping[str, Any]) -> Array:
        """The same as the solver sees them."""
        local = self.shooting.local
        return local.along(local.expressions.rows, ts, xs, us, params)

    # ---- what a solve starts from -----------------------------------------------------------------------------------

    def at_ends(self, xs: Any, ends: Ends) -> dict[str, Array]:
        """States at the nodes with what ends fix in place.

        Raises:
            TrajectoryError: they are those of another problem.
        """
        shapes = {s.name: (self.nodes, *s.shape) for s in self.dynamics.states}
        if not isinstance(xs, dict) or {name: np.shape(a) for name, a in xs.items()} != shapes:
            raise other_problem()
        return {
            s.name: state_guess(s, xs[s.name], ends.initial[s.name], ends.final[s.name], self.mesh.shares)
            for s in self.dynamics.states
        }

    def other_ends(self, initial: Mapping[Any, Any] | None, final: Mapping[Any, Any] | None) -> Ends:
        """The ends with other values; the same entries are fixed."""
        if initial is None and final is None:
            return self.ends
        sides = []
        for what, known, values in (("initial", self.ends.initial, initial), ("final", self.ends.final, final)):
            if values is not None and not isinstance(values, Mapping):
                raise ModelError(
                    f"solve: {what} must be a dict from states to values, got {type(values).__name__}; "
                    "constraints belong to the problem"
                )
            sides.append({**known, **{name_of(key): value for key, value in (values or {}).items()}})
        ends = ends_of(self.dynamics.states, *sides)
        for what in ("initial", "final"):
            fixed, stated = (getattr(side, f"{what}_fixed") for side in (ends, self.ends))
            changed = next((name for name in fixed if (fixed[name] != stated[name]).any()), None)
            if changed is not None:
                value = getattr(ends, what)[changed]
                raise TrajectoryError(
                    f"solve: {what}[{changed!r}] must fix the entries that the problem fixes, got "
                    f"{short(None if value is None else value.tolist())}.\n"
                    "  fix: state the problem with a value there, or with NaN in what is free"
                )
        return ends

    def other_times(self, limits: Any, guess: Any) -> tuple[tuple[float, float], float]:
        """Other limits of the final time, and where it starts."""
        if limits is None and guess is None:
            return self.time_limits, self.time_guess
        times = times_of(self.time_limits if limits is None else limits, guess)
        is_free = self.time_limits[0] < self.time_limits[1]
        if (times[0][0] < times[0][1]) != is_free:
            kind = "free: (low, high)" if is_free else "fixed: a number"
            raise TrajectoryError(f"solve: final_time expects what the problem has, {kind}, got {limits!r}")
        return times

    def checked_guess(self, guess: Mapping[Any, Any] | None) -> dict[str, Array]:
        """A guess by name, on top of that of the statement."""
        return self.own_guess | user_guess(guess, self._guessed, self._lengths)

    @property
    def _guessed(self) -> dict[str, State | Control]:
        return self._leaves | {box.name: box for box in self.border.boxes}

    def axes(self) -> dict[str, Any]:
        """How many axes each argument of a solve has; a guess of states or controls may have one more."""
        leaves = {name: len(leaf.shape) for name, leaf in self._leaves.items()}
        longer = {name: count + 1 for name, count in leaves.items()}
        times = int(self.time_limits[0] < self.time_limits[1])
        return {"guess": longer, "initial": leaves, "final": leaves, "final_time": times}

    def stated_values(self, params: Mapping[str, Array]) -> tuple[dict[str, Array], dict[str, Array]]:
        """What conditions say of states at both ends."""
        known = {**params, **self.softened.without}
        first, last = (stated_values(self.dynamics.states, rows.values(), known) for rows in self._at_ends)
        return first, last

    def start(
        self,
        guess: Mapping[str, Array],
        ends: Ends,
        params: Mapping[str, Array],
        durations: Array,
        limits: Array,
        sizes: Mapping[str, Array] = {},
    ) -> Point:
        """The point that guesses give, with these durations, within limits of the border.

        Bounds of norms and of magnitudes, and extremes, fit controls; those that are zero count with their sizes.
        """
        count, (first, last) = self.nodes - 1, self.stated_values(params)
        xs = {}
        for s in self.dynamics.states:
            sides, stated = (ends.initial[s.name], ends.final[s.name]), (first.get(s.name), last.get(s.name))
            xs[s.name] = state_guess(s, guess.get(s.name), *sides, self.mesh.shares, stated)
        us = {c.name: control_guess(c, guess.get(c.name), count) for c in self.dynamics.controls}
        xs |= self.reduced.starts_of(xs)
        sized = _sized(xs | us, sizes)
        for name, values in bounds_along(self.reduced.bounds | self.restated.bounds, sized, params).items():
            (us if name in us else xs)[name] = above(values)
        ts = self.shooting.times(durations)
        xs, us = self.restated.started(xs, us, ts)
        # Rows may have any sign: controls that say nothing count with both.
        sides = [{name: side * a for name, a in sizes.items()} for side in (1.0, -1.0)]
        rows = self._shown_at([(xs, us), *((_sized(xs, own), _sized(us, own)) for own in sides)], params, ts)
        extremes = self.reduced.extremes_of(np.concatenate(rows), self.path.shown, params) if rows else {}
        residuals = self.softened.values(self.conditions, xs, ts, params) if self.softened.slacks else {}
        border = self.border.start(durations, params, {**extremes, **self.softened.start(residuals), **guess}, limits)
        flat = [np.zeros((count, 0)), *(us[c.name].reshape(count, -1) for c in self.dynamics.controls)]
        norms = self.norms.guess(_sized(us, sizes), {**params, **self.border.params(border)})
        slacks = self.norms.start(rows[0], list(self.path.shown), count) if self.norms.slacks else []
        return Point(xs, np.concatenate([*flat, *norms, *slacks], axis=1), border)

    def _shown_at(
        self, points: Iterable[tuple[dict[str, Array], dict[str, Array]]], params: Mapping[str, Array], ts: Array
    ) -> list[Array]:
        """The path rows as users wrote them of states and controls at nodes, where something has to fit them."""
        if not (self.reduced.extremes or self.norms.slacks):
            return []
        rows: list[Array] = []
        norms = {c.name: np.zeros((self.nodes - 1, *c.shape)) for c in self.norms.controls}
        for xs, us in points:
            before = {name: a[:-1] for name, a in xs.items()}
            rows.append(np.asarray(self.shown_rows(ts[:-1], before, us | norms, dict(params))))
        return rows

    def filled(self, values: Mapping[str, Array | None]) -> dict[str, Array]:
        """Values of the states, with anything where they are free."""
        filled = {}
        for state in self.dynamics.states:
            value = values[state.name]
            rest = np.zeros(state.shape) if state.group.flat else np.asarray(state.group.identity(float))
            filled[state.name] = rest if value is None else np.where(np.isnan(value), rest, value)
        return filled


def _sized(values: Mapping[str, Array], sizes: Mapping[str, Array]) -> dict[str, Array]:
    """Values by leaf, those that are nothing beside their sizes at these."""
    sized = dict(values)
    for name, size in sizes.items():
        if name in sized and np.abs(sized[name]).max(initial=0.0) <= _NOTHING * np.abs(size).max(initial=0.0):
            sized[name] = np.broadcast_to(size.reshape(sized[name].shape[1:]), sized[name].shape)
    return sized
