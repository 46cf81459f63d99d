"""A phase of a problem in the form that the transcription reads."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy import ndarray as Array

from ...checks import short
from ...errors import ModelError, TrajectoryError
from ...expr import Control, Parameter, State, leaves_of
from ...linear.free_parameters import boxes_of
from ...system import entry_names, name_of
from ..hessians.options import checked_hessian
from ..strategy.warm import other_problem
from ..transcription.border import Border, times_of
from ..transcription.iterate import Iterate
from ..transcription.mesh import mesh_of
from ..transcription.methods import transcription_of
from ..transcription.shooting import Shooting
from .bridges.bridge import Bridge, Path, Statement, place_of
from .bridges.continuous_controls import ContinuousControls
from .bridges.lifted_functionals import InPhase, LiftedFunctionals
from .bridges.path_bounds import NodeSlacks, PathBounds, check_weights
from .by_node import ByNode
from .conditions import Conditions, Ends, at_nodes, conditions, ends_of, split, stated_values
from .controls import continuous_controls
from .guess import control_guess, state_guess, user_guess
from .phase import Phase
from .statement import Objective, Reads, check_leaves, check_limits, describe_path, largest_by_name, violations


class StatedPhase:
    """A phase after all bridges: it has no functionals, soft constraints or continuous controls.

    Args:
        phase: as stated.
        objective: its contribution to the objective.
        within: the properties of the whole problem that the bridges need.

    Attributes:
        phase: the phase as stated.
        dynamics, objective: with the variables that the bridges added.
        bridges: in the order in which they are applied.
        path: the path constraints.
        shooting: its transcription.
        border: the unknowns that all phases share.
        number: the index of the phase.
        bounds: the parameters that the bridges added, with their limits.
        parameters: the parameters of the system and those that only the problem reads, by name.
        readable: the parameters that the problem reads.
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
        check_limits(dynamics.states)
        for place, expr in (("the objective", self.objective.final), ("the running cost", self.objective.running)):
            if expr is not None:
                check_leaves(dynamics, place, expr, controls=expr is self.objective.running)
        # Initial and final values that users declare belong to the ends of the whole path; those of states from bridges
        # belong to the phase.
        inner_ends = {s.name for s in dynamics.states} - {s.name for s in phase.dynamics.states}
        all_states = {s.name for s in dynamics.states}
        declared = (all_states if within.first else inner_ends, all_states if within.last else inner_ends)
        self.ends = ends_of(dynamics.states, first, last, declared)
        self._leaves: dict[str, State | Control] = {leaf.name: leaf for leaf in dynamics.states}
        self._leaves |= {leaf.name: leaf for leaf in dynamics.controls}
        self._lengths = {name: self.nodes - isinstance(leaf, Control) for name, leaf in self._leaves.items()}
        self._read_parameters()

    def _bridge(self, objective: Objective, rows: Mapping[int, Any], within: InPhase) -> None:
        phase, dynamics = self.phase, self.phase.dynamics
        statement = Statement(dynamics, objective, rows, continuous_controls(phase.controls, dynamics.controls))
        self.node_slacks = NodeSlacks(statement, f"{within.name}: " if within.name else "")
        self.functionals = LiftedFunctionals(self.node_slacks.statement, within)
        self.continuous = ContinuousControls(self.functionals.statement, self.mesh, within.first)
        self.path_bounds = PathBounds(self.continuous.statement, dynamics.system.soft, self.continuous.put)
        self.bridges: list[Bridge] = [self.node_slacks, self.functionals, self.continuous, self.path_bounds]
        simplest = self.path_bounds.statement
        self.dynamics, self.objective, self.rows = simplest.dynamics, simplest.objective, simplest.rows
        last = self.nodes - 1
        #: The conditions at nodes by index: those of the first node are second to last, those of the last node are
        #: last.
        stated_at = {k: place_of(k, last) for k in sorted(self.rows, key=lambda k: (k == last, k == 0, k))}
        self.conditions = {
            k: conditions(self.dynamics, place, self.rows[k])
            for k, place in stated_at.items()
            if self.rows[k] or k == last
        }

    def _read_parameters(self) -> None:
        """Find the parameters, and the parameters that the problem reads."""
        at_nodes = [row for rows in self.conditions.values() for row in rows.residuals]
        priced = [e for e in (self.objective.final, self.path_bounds.running) if e is not None]
        running = [] if self.objective.running is None else [self.objective.running]
        leaves = list(leaves_of(*priced, *running, *at_nodes))
        known = {leaf.name: leaf for leaf in self.dynamics.parameters}
        added = {e.name: e for e in leaves if isinstance(e, Parameter) and e.name not in known}
        self.parameters = known | added
        reads = self.dynamics.functions.reads
        of_system = reads["rates"] | reads["constraints"]
        seen = of_system | {leaf.name for leaf in leaves}
        self.readable = [*(leaf for leaf in known.values() if leaf.name in seen), *added.values()]
        self.baked = {leaf.name for leaf in self.dynamics.system.parameters} - set(known)
        self.by_node = ByNode.of(self.phase.by_node, self.mesh.shares)
        self.bounds = boxes_of({k: v for b in self.bridges for k, v in b.free.items()}, self.readable, ())
        elsewhere = [*at_nodes, *(row for _, row in self.path_bounds.rows)]
        self._check_by_node = functools.partial(self.by_node.check, priced, elsewhere, of_system)

    def transcribe(self, number: int, border: Border) -> None:
        """Transcribe the phase with the durations and free parameters of its problem."""
        self.number, self.border = number, border
        free = {box.name for box in border.boxes}
        self._check_by_node(free)
        self.own_guess = user_guess(self.phase.guess, self._guessed, self._lengths)
        self.path = describe_path(
            self.dynamics,
            self.path_bounds,
            free,
            self.continuous.straight,
            of_steps=self.transcription.scheme.at_end,
        )
        self.shooting = Shooting(
            self.dynamics,
            self.objective,
            transcription=self.transcription,
            mesh=self.mesh,
            path=self.path,
            norms=self.path_bounds,
            ends=self.ends,
            final=self.conditions[self.nodes - 1],
            at_nodes=self.node_rows,
            border=border,
            phase=number,
            pace=self.continuous.pace,
            by_node=self.by_node,
        )
        self.squares = None if self.hessian is None else self.hessian.squares(self.shooting)
        self.shooting.alike = {name: state.name for name, state in self.functionals.starts.items()}

    def __getstate__(self) -> dict[str, Any]:
        """Everything but compiled functions, which compile again in another process."""
        return {k: v for k, v in self.__dict__.items() if k not in ("shooting", "squares")}

    def __repr__(self) -> str:
        low, high = self.time_limits
        times = f"{low:g} s" if low == high else f"{low:g} to {high:g} s"
        return f"{self.phase.objective}, {self.nodes} nodes, {times}, {self.phase.dynamics}"

    @property
    def bounded(self) -> bool:
        """Whether bridges introduced bounds of norms, or extremes, whose initial values depend on sizes of controls."""
        functionals, continuous = self.functionals, self.continuous
        return bool(self.path_bounds.controls or functionals.bounds or functionals.extremes or continuous.bounds)

    @property
    def node_rows(self) -> dict[int, Conditions]:
        """The conditions at nodes before the last."""
        return {k: rows for k, rows in self.conditions.items() if k < self.nodes - 1}

    @property
    def final_rows(self) -> Conditions:
        """The conditions at the last node."""
        return self.conditions[self.nodes - 1]

    @property
    def soft(self) -> set[str]:
        """The names of soft constraints, entry by entry."""
        on_path = self.path_bounds.soft.items()
        return {
            row for name, soft in on_path for row in entry_names(name, soft.constraint.shape)
        } | self.node_slacks.rows

    @property
    def order(self) -> int:
        """The order of the derivatives that are compiled: 1 or 2."""
        return 2 if self.hessian is None else 1

    def check_weights(self, params: Mapping[str, Array]) -> None:
        """Raise InputError if parameter values make the weight of a soft constraint negative."""
        at_nodes = {name: slack.soft for name, slack in self.node_slacks.slacks.items()}
        check_weights({**self.path_bounds.soft, **at_nodes}, params)

    def shown_rows(self, ts: Array, xs: Mapping[str, Any], us: Mapping[str, Any], params: Mapping[str, Any]) -> Array:
        """(points, rows) the path constraints as users wrote them, at many points."""
        local = self.shooting.local
        return local.along(local.expressions.shown, ts, xs, us, params)

    def path_rows(self, ts: Array, xs: Mapping[str, Any], us: Mapping[str, Any], params: Mapping[str, Any]) -> Array:
        """(points, rows) the path constraints in the solver's form, at many points."""
        local = self.shooting.local
        return local.along(local.expressions.rows, ts, xs, us, params)

    def violated_by_state(self, x: Mapping[str, Any], params: Mapping[str, Any]) -> dict[str, float]:
        """The limits and constraints that a state alone violates, except soft ones: name -> violation in its unit."""
        local, path = self.shooting.local, self.path
        controls = local.controls.split(np.zeros((1, local.controls.dimension)))
        rows = self.shown_rows(np.zeros(1), {name: np.asarray(a)[None] for name, a in x.items()}, controls, params)
        largest = largest_by_name(path.shown, violations(rows[0], path.shown_equality))
        of_states = {
            name
            for name, reads, states in zip(path.names, path.reads, path.states)
            if reads in (Reads.STATE, Reads.ENDS) and states.isdisjoint(self.continuous.smooth)
        }
        return {name: size for name, size in largest.items() if size > 0.0 and name in of_states - self.soft}

    # ---- what a solve starts from -----------------------------------------------------------------------------------

    def at_ends(self, xs: Any, ends: Ends) -> dict[str, Array]:
        """States at the nodes in which fixed initial and final entries have their values.

        Raises:
            TrajectoryError: the states belong to another problem.
        """
        shapes = {s.name: (self.nodes, *s.shape) for s in self.dynamics.states}
        if not isinstance(xs, dict) or {name: np.shape(a) for name, a in xs.items()} != shapes:
            raise other_problem()
        return {
            s.name: state_guess(s, xs[s.name], ends.initial[s.name], ends.final[s.name], self.mesh.shares)
            for s in self.dynamics.states
        }

    def other_ends(self, initial: Mapping[Any, Any] | None, final: Mapping[Any, Any] | None) -> Ends:
        """The initial and final values with other numbers; the fixed entries must be the same."""
        if initial is None and final is None:
            return self.ends
        sides: list[Any] = []
        for what, known, values in (("initial", self.ends.initial, initial), ("final", self.ends.final, final)):
            if values is not None and not isinstance(values, Mapping):
                raise ModelError(
                    f"solve: {what} must be a dict from states to values, got {type(values).__name__}; "
                    "constraints belong to the problem"
                )
            sides.append({**known, **{name_of(key): value for key, value in (values or {}).items()}})
        ends = ends_of(self.dynamics.states, sides[0], sides[1])
        for what in ("initial", "final"):
            fixed, before = (getattr(side, f"{what}_fixed") for side in (ends, self.ends))
            changed = next((name for name in fixed if (fixed[name] != before[name]).any()), None)
            if changed is not None:
                value = getattr(ends, what)[changed]
                raise TrajectoryError(
                    f"solve: {what}[{changed!r}] must fix the entries that the problem fixes, got "
                    f"{short(None if value is None else value.tolist())}.\n"
                    "  fix: state the problem with a value there, or with NaN in what is free"
                )
        return ends

    def other_times(self, limits: Any, guess: Any) -> tuple[tuple[float, float], float]:
        """Other limits of the final time, with its initial guess."""
        if limits is None and guess is None:
            return self.time_limits, self.time_guess
        times = times_of(self.time_limits if limits is None else limits, guess)
        is_free = self.time_limits[0] < self.time_limits[1]
        if (times[0][0] < times[0][1]) != is_free:
            kind = "limits (low, high), because it is free" if is_free else "a number, because it is fixed"
            raise TrajectoryError(f"solve: final_time expects {kind} in the problem, got {limits!r}")
        return times

    def checked_guess(self, guess: Mapping[Any, Any] | None) -> dict[str, Array]:
        """Checked guesses by name, which replace those of the statement."""
        return self.own_guess | user_guess(guess, self._guessed, self._lengths)

    @property
    def _guessed(self) -> dict[str, State | Control]:
        return self._leaves | {box.name: box for box in self.border.boxes}

    def axes(self) -> dict[str, Any]:
        """The number of axes of each argument of a solve; a guess of states or controls may have one more."""
        leaves = {name: len(leaf.shape) for name, leaf in self._leaves.items()}
        longer = {name: count + 1 for name, count in leaves.items()}
        times = int(self.time_limits[0] < self.time_limits[1])
        return {"guess": longer, "initial": leaves, "final": leaves, "final_time": times}

    def stated_values(self, params: Mapping[str, Array]) -> tuple[dict[str, Array], dict[str, Array]]:
        """The values that conditions prescribe for states at both ends."""
        known = {**params, **self.node_slacks.without}
        ends = (self.rows[0], self.rows[self.nodes - 1])
        first, last = (stated_values(self.dynamics.states, rows.values(), known) for rows in ends)
        return first, last

    def start(
        self,
        guess: Mapping[str, Array],
        ends: Ends,
        params: Mapping[str, Array],
        durations: Array,
        limits: Array,
        sizes: Mapping[str, Array] = {},
    ) -> Iterate:
        """The start from guesses with these durations, projected onto the limits of durations and free parameters.

        Bounds of norms and magnitudes, and extremes, start at the values for these controls; controls that are zero are
        replaced by their typical sizes.
        """
        first, last = self.stated_values(params)
        path = Path(self.shooting.times(durations), {}, {}, params, sizes)
        for s in self.dynamics.states:
            sides, end_values = (ends.initial[s.name], ends.final[s.name]), (first.get(s.name), last.get(s.name))
            path.xs[s.name] = state_guess(s, guess.get(s.name), *sides, self.mesh.shares, end_values)
        count, controls = self.nodes - 1, self.dynamics.controls
        path.us |= {c.name: control_guess(c, guess.get(c.name), count) for c in controls}
        for bridge in self.bridges:
            bridge.complete(path)
        values = {name: value for bridge in self.bridges for name, value in bridge.parameters(path, self).items()}
        border = self.border.start(durations, params, {**values, **guess}, limits)
        path.params = {**params, **self.border.params(border)}
        flat = [np.zeros((count, 0)), *(path.us[c.name].reshape(count, -1) for c in controls)]
        return Iterate(path.xs, np.concatenate([*flat, *self.path_bounds.columns(path, self)], axis=1), border)

    def shown_along(self, path: Path) -> Array:
        """(intervals, rows) the path constraints as users wrote them, at all nodes but the last."""
        us = path.us | {c.name: np.zeros((self.nodes - 1, *c.shape)) for c in self.path_bounds.controls}
        xs = {name: values[:-1] for name, values in path.xs.items()}
        return np.asarray(self.shown_rows(path.ts[:-1], xs, us, dict(path.params)))

    # ---- between a trajectory as stated and as solved ----------------------------------------------------------------

    def seen(self, xs: Mapping[str, Any], us: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
        """States and controls of the original problem, from those of the transcription."""
        states, controls = dict(xs), dict(us)
        for bridge in reversed(self.bridges):
            states, controls = bridge.back(states, controls)
        return states, controls

    def lifted(self, ts: Array, xs: Mapping[str, Array], us: Mapping[str, Array], params: Mapping[str, Array]) -> Path:
        """States and piecewise constant controls of the transcription, from those of the original problem."""
        path = Path(ts, dict(xs), dict(us), params)
        for bridge in self.bridges:
            bridge.forward(path)
        return path

    def filled(self, values: Mapping[str, Array | None]) -> dict[str, Array]:
        """Values of the states; free entries are zero, or those of the identity of a group."""
        filled = {}
        for state in self.dynamics.states:
            value = values[state.name]
            rest = np.zeros(state.shape) if state.group.flat else np.asarray(state.group.identity(float))
            filled[state.name] = rest if value is None else np.where(np.isnan(value), rest, value)
        return filled
