"""An optimal-control problem on a compiled system: stated once, compiled once, solved as often as one likes."""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import numpy as np
from numpy import ndarray as Array

from ..checks import listed, reals, short
from ..errors import InputError, ModelError, ShapeError, TrajectoryError
from ..expr import Control, Parameter, State, leaves_of
from ..jax_inside import in_double
from ..system import entry_names, name_of
from ..system.dynamics import need_compiled
from .border import Border, boxes_of, times_of
from .by_node import ByNode
from .cases import TrajectoryResults, trajectory_results
from .conditions import Conditions, Ends, at_nodes, conditions, ends_of, split
from .cones import above, bounds_along, norm_controls
from .controls import continuous_controls
from .found import Tried
from .guess import control_guess, state_guess, user_guess
from .hessians import checked_hessian
from .mesh import Remeshed, mesh_of
from .reduction import InPhase, Reduction
from .restated import Restated
from .result import TrajectoryResult, best_result
from .shooting import Shooting
from .slacks import NodeSlacks, slack_controls
from .solving import Solvable, Started
from .statement import Objective, check_leaves, describe_path
from .transcribed import Given, Point
from .transcription import transcription_of
from .warm import other_problem

#: A control of less than this share of its size says nothing of it.
_NOTHING = 1e-4


class Problem(Solvable[TrajectoryResult, TrajectoryResults]):
    """Find controls, states and final time that optimise an objective under a system's constraints.

    minimise J subject to $x' = f(t, x, u)$, the system's constraints and the boxes of its leaves along the path,
    conditions at both ends, and limits of the final time. Controls are held over each of nodes - 1 intervals.
    Constraints on states are asked at the nodes and at the ends of the substeps between them.

    The problem is always solved in double precision, whatever the global setting.

    Args:
        dynamics: a compiled system, or a list of `Phase`; then the rest is as for `PhasedProblem`.
        objective: `tx.Minimize(...)` or `tx.Maximize(...)`.
        nodes: number of state nodes, two or more, at equal distances; or where they lie, as an increasing sequence of
            shares of the final time from 0 to 1; or a `tx.trajectory.Mesh`, whose intervals may be free.
        final_time: a number in s, or limits (low, high) to leave it free.
        initial, final: values by state or name, on top of the leaves' own, or constraints on the first or last node
            such as `g[:3, 3] == 0`, or a list of both. NaN or None entries of values are free; of a pose the whole
            position or the whole attitude may be.
        at: constraints at inner nodes by the number of the node, 1 to nodes - 2, each one or a list.
        params: values of the parameters by leaf or name, the objective's too; those left out take their own.
        free: parameters, by leaf or name, that the optimiser may move, each with limits (low, high), numbers or arrays
            of its shape; None or an infinity leaves a side open. A list of parameters leaves all sides open.
        by_node: a list of parameters of the objective, references and weights, whose values in `params` have a row for
            each node, or are one for all. They are linear in time between nodes; the final cost reads the last row.
        controls: how controls go on between nodes, `tx.trajectory.Held()` (if left out), `tx.trajectory.Linear()` or
            `tx.trajectory.Spline(degree)`, for all of them, or a dict by leaf or name.
        guess: values by leaf or name, on top of the leaves' own: one, or one for each node (states, continuous
            controls) or interval (held controls). A free parameter starts here, else at its value, or at the point of
            its box nearest to that.
        final_time_guess: where a free final time starts; unless given the middle of its limits, or where the upper is
            more than a hundred times the lower the middle of their logarithms.
        transcription: how an interval is integrated, in exponential coordinates about its first node:
            `tx.trajectory.MultipleShooting(method, substeps)` or `tx.trajectory.Collocation(tableau)`.
        method, substeps: those of multiple shooting in place of it: an RKMK method with an explicit tableau, RK4 if
            left out, and its steps in an interval, 2 if left out.
        hessian: second derivatives other than exact ones: `tx.trajectory.GaussNewton()` or
            `tx.trajectory.QuasiNewton()`.

    Raises:
        ModelError: unknown names or values without meaning.
        ShapeError: a wrong shape.
        TrajectoryError: nodes, times or end values that cannot be.
        InputError: parameters without a value.
    """

    shooting: Shooting

    def __new__(cls, dynamics: Any = None, *args: Any, **options: Any) -> Any:
        """A problem, or one of several phases where a list of `Phase` is given."""
        if not isinstance(dynamics, (list, tuple)):
            return super().__new__(cls)
        from .phases import PhasedProblem

        if strangers := set(options) - {"links", "params", "free"}:
            raise ModelError(
                f"Problem of phases expects links, params and free alone, got {listed(sorted(strangers))}.\n"
                "  fix: give it to each tx.trajectory.Phase"
            )
        return PhasedProblem(dynamics, *args, **options)

    def __init__(
        self,
        dynamics: Any,
        objective: Any = None,
        *,
        nodes: Any = 25,
        final_time: Any = None,
        initial: Any = None,
        final: Any = None,
        at: Any = None,
        params: Mapping[Any, Any] | None = None,
        free: Any = None,
        by_node: Any = None,
        controls: Any = None,
        guess: Mapping[Any, Any] | None = None,
        final_time_guess: Any = None,
        transcription: Any = None,
        method: Any = None,
        substeps: Any = None,
        hessian: Any = None,
        _within: InPhase = InPhase(),  # noqa: B008  it is frozen
    ) -> None:
        need_compiled("Problem", dynamics)
        own = dict(locals())
        #: What it was stated with.
        self._stated = {name: own[name] for name in inspect.signature(Problem.__init__).parameters if name != "self"}
        if not isinstance(objective, Objective):
            raise ModelError(
                f"Problem expects tx.Minimize(...) or tx.Maximize(...) as objective, got {type(objective).__name__}"
            )
        self.mesh = mesh_of(nodes)
        self.nodes = self.mesh.nodes
        time_limits, self.time_guess = times_of(final_time, final_time_guess)
        (first, asked_first), (last, asked_last) = split("initial", initial), split("final", final)
        inner, soft = at_nodes(at, self.nodes), dynamics.system.soft
        places = {"initial": asked_first, "final": asked_last, **{f"node {k}": own for k, own in inner.items()}}
        #: What soft conditions at nodes became.
        self.softened = softened = NodeSlacks(objective, places, f"{_within.name}: " if _within.name else "")
        first_rows, last_rows, *inner_rows = softened.plain.values()
        smooth = continuous_controls(controls, dynamics.controls)
        reduced = Reduction(dynamics, softened.objective, first_rows, last_rows, inner_rows, _within, smooth)
        #: What functionals of the path became.
        self.reduced = reduced
        ways = reduced.shapes_of_bounds(controls)
        restated = Restated(reduced.dynamics, reduced.objective, ways, self.mesh, _within.first, added=reduced.bounds)
        #: What linear controls and free node times became.
        self.restated = restated
        self.dynamics = dynamics = restated.dynamics
        self.objective: Objective = restated.objective
        for place, expr in (("the objective", self.objective.final), ("the running cost", self.objective.running)):
            if expr is not None:
                check_leaves(dynamics, place, expr, controls=expr is self.objective.running)
        objective = self.objective
        self.ends = ends_of(dynamics.states, first, last)
        self.final_rows = conditions(
            dynamics, "final", restated.plain(reduced.plain(last_rows) | restated.at_end, last=True)
        )
        #: Conditions at nodes before the last.
        plain = {k: restated.plain(reduced.plain(own)) for k, own in zip(inner, inner_rows)}
        self.node_rows = {k: conditions(dynamics, f"node {k}", own) for k, own in plain.items()}
        first_rows = restated.plain(first_rows | reduced.at_start)
        if first_rows:
            self.node_rows[0] = conditions(dynamics, "initial", first_rows)
        self._leaves: dict[str, State | Control] = {s.name: s for s in dynamics.states}
        self._leaves |= {c.name: c for c in dynamics.controls}
        self._lengths = {name: self.nodes - isinstance(leaf, Control) for name, leaf in self._leaves.items()}
        self.transcription = transcription_of(transcription, method, substeps)
        self.hessian = checked_hessian(hessian)
        self.norms = slack_controls(norm_controls(objective.running, objective.sign), restated, soft)
        asked = [e for own in (self.final_rows, *self.node_rows.values()) for e in own.residuals]
        exprs = [e for e in (objective.final, objective.running, self.norms.running, *asked) if e is not None]
        known = {leaf.name for leaf in dynamics.parameters}
        #: Parameters that the system does not have.
        self._own = {
            leaf.name: leaf
            for expr in exprs
            for leaf in leaves_of(expr)
            if isinstance(leaf, Parameter) and leaf.name not in known
        }
        reads, seen = dynamics._functions.reads, {leaf.name for expr in exprs for leaf in leaves_of(expr)}
        seen |= reads["rates"] | reads["constraints"]
        #: Parameters that the problem reads, and the names of those that cannot be changed any more.
        self.readable = [*(leaf for leaf in dynamics.parameters if leaf.name in seen), *self._own.values()]
        self.by_node = ByNode.of(by_node, self.mesh.shares)
        elsewhere = [*asked, *(row for _, row in self.norms.rows)]
        priced = [e for e in (objective.final, self.norms.running) if e is not None]
        self.by_node.check(priced, elsewhere, reads["rates"] | reads["constraints"])
        self.baked = {leaf.name for leaf in dynamics.system.parameters} - known
        #: Parameters that stand for extremes, and slacks.
        self.bounds = boxes_of({**reduced.free, **softened.free}, self.readable, ())
        boxes = (*boxes_of(free, self.readable, self.baked), *self.bounds)
        self.border = Border(("final time",), np.array([time_limits]), boxes)
        self.phase = 0
        self.own_guess = self.checked_guess(guess)
        self.params = self._prepared(params)
        self._build()

    def __repr__(self) -> str:
        low, high = self.time_limits
        times = f"{low:g} s" if low == high else f"{low:g} to {high:g} s"
        shown = (self._stated["objective"], f"{self.nodes} nodes", times, self._stated["dynamics"])
        return f"{type(self).__name__}({', '.join(map(str, shown))})"

    def on(self, meshes: Sequence[Remeshed]) -> Problem:
        (mesh,) = meshes
        return Problem(**self._stated | {"by_node": self.by_node} | mesh.stated(self._stated["at"]))

    def transcribed_by(self, transcription: Any) -> Problem:
        return self.stated_with(transcription=transcription, method=None, substeps=None)

    def stated_with(self, **others: Any) -> Problem:
        """The same problem with other arguments."""
        return Problem(**self._stated | others)

    def as_phase(self, number: int, border: Border) -> None:
        """Make it a phase of a problem with these durations and free parameters."""
        self.phase, self.border = number, border
        self._build()

    @property
    def bounded(self) -> bool:
        """Whether it has bounds of its own: of norms, of magnitudes, or extremes."""
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

    @property
    def parts(self) -> Sequence[Problem]:
        return [self]

    @property
    def sign(self) -> float:
        return self.objective.sign

    @property
    def time_limits(self) -> tuple[float, float]:
        """Low and high, equal where the final time is fixed."""
        low, high = self.border.time_limits[self.phase].tolist()
        return low, high

    def _build(self) -> None:
        """What compiles."""
        self.path = describe_path(
            self.dynamics, self.norms, {box.name for box in self.border.boxes}, self.restated.straight
        )
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
            border=self.border,
            phase=self.phase,
            pace=self.restated.pace,
            by_node=self.by_node,
        )
        self.squares = None if self.hessian is None else self.hessian.squares(self.shooting)
        self.shooting.alike = {name: state.name for name, state in self.reduced.starts.items()}
        self.built()
        self.advanced = jax.jit(self.shooting.advanced)

    def shown_rows(self, ts: Array, xs: Mapping[str, Any], us: Mapping[str, Any], params: Mapping[str, Any]) -> Array:
        """(points, rows) the path rows as users wrote them, at many points."""
        local = self.shooting.local
        return local.along(local.expressions.shown, ts, xs, us, params)

    def path_rows(self, ts: Array, xs: Mapping[str, Any], us: Mapping[str, Any], params: Mapping[str, Any]) -> Array:
        """The same as the solver sees them."""
        local = self.shooting.local
        return local.along(local.expressions.rows, ts, xs, us, params)

    def __getstate__(self) -> dict[str, Any]:
        """Without what compiles anew in another process."""
        return {k: v for k, v in self.__dict__.items() if k not in ("shooting", "advanced", "_cores", "_implicit")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__ |= state
        self._build()

    # ---- what a solve starts from ---------------------------------------------------------------------------------

    def started(
        self,
        guess: Mapping[Any, Any] | None = None,
        initial: Mapping[Any, Any] | None = None,
        final: Mapping[Any, Any] | None = None,
        params: Mapping[Any, Any] | None = None,
        final_time: Any = None,
        final_time_guess: Any = None,
        free: Mapping[Any, Any] | None = None,
        sizes: Sequence[Mapping[str, Array]] | None = None,
        begin: Point | None = None,
    ) -> Started:
        """What `solve` with these arguments starts from and is for; in double precision."""
        ends = self.other_ends(initial, final)
        times, time_guess = self.other_times(final_time, final_time_guess)
        limits = self.border.limited(np.array([times]), free)
        if params is not None and not isinstance(params, Mapping):
            raise InputError(f"solve: params must be a dict from parameters to values, got {short(params)}")
        own = self.params if params is None else self._prepared({**self.params, **params})
        if begin is None:
            known, own_sizes = self.own_guess | self.checked_guess(guess), {} if sizes is None else sizes[0]
            begin = self.start(known, ends, own, np.array([time_guess]), limits, own_sizes)
        return Started(begin, self.given(ends, own, limits), own, ends)

    def axes(self) -> dict[str, Any]:
        """How many axes each argument of `started` has; a guess of states or controls has one more."""
        leaves = {name: len(leaf.shape) for name, leaf in self._leaves.items()}
        params = {name: value.ndim for name, value in self.params.items()}
        longer = {name: count + 1 for name, count in leaves.items()}
        times = int(self.border.free[self.phase])
        return {"guess": params | longer, "initial": leaves, "final": leaves, "params": params, "final_time": times}

    def result(self, tried: Tried) -> TrajectoryResult:
        return best_result(self, tried)

    def results(self, tried: Sequence[Tried]) -> TrajectoryResults:
        return trajectory_results(self, tried)

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
        for what, own, new in (("initial", self.ends.initial, initial), ("final", self.ends.final, final)):
            if new is not None and not isinstance(new, Mapping):
                raise ModelError(
                    f"solve: {what} must be a dict from states to values, got {type(new).__name__}; "
                    "constraints belong to the problem"
                )
            sides.append(
                {n: v for n, v in own.items() if v is not None} | {name_of(k): v for k, v in (new or {}).items()}
            )
        ends = ends_of(self.dynamics.states, *sides)
        for what, fixed, stated in (
            ("initial", ends.initial_fixed, self.ends.initial_fixed),
            ("final", ends.final_fixed, self.ends.final_fixed),
        ):
            other = [name for name in fixed if (fixed[name] != stated[name]).any()]
            if other:
                raise TrajectoryError(
                    f"solve: {what}[{other[0]!r}] must fix the entries that the problem fixes.\n"
                    "  fix: state the problem with a value there, or with NaN in what is free"
                )
        return ends

    def other_times(self, limits: Any, guess: Any) -> tuple[tuple[float, float], float]:
        """Other limits of the final time, and where it starts."""
        if limits is None and guess is None:
            return self.time_limits, self.time_guess
        found = times_of(self.time_limits if limits is None else limits, guess)
        free = self.border.free[self.phase]
        if (found[0][0] < found[0][1]) != free:
            kind = "free: (low, high)" if free else "fixed: a number"
            raise TrajectoryError(f"solve: final_time expects what the problem has, {kind}, got {limits!r}")
        return found

    def checked_guess(self, guess: Mapping[Any, Any] | None) -> dict[str, Array]:
        """A guess by name."""
        return user_guess(guess, self._leaves | {box.name: box for box in self.border.boxes}, self._lengths)

    def start(
        self,
        given: Mapping[str, Array],
        ends: Ends,
        params: Mapping[str, Array],
        durations: Array,
        limits: Array,
        sizes: Mapping[str, Array] = {},
    ) -> Point:
        """The point that guesses give, with these durations, within limits of the border.

        Bounds of norms and of magnitudes, and extremes, fit controls; those that are zero count with their sizes.
        """
        count = self.nodes - 1
        xs = {
            s.name: state_guess(s, given.get(s.name), ends.initial[s.name], ends.final[s.name], self.mesh.shares)
            for s in self.dynamics.states
        }
        us = {c.name: control_guess(c, given.get(c.name), count) for c in self.dynamics.controls}
        xs |= self.reduced.starts_of(xs)
        whole = _sized(xs | us, sizes)
        for name, values in bounds_along(self.reduced.bounds | self.restated.bounds, whole, params).items():
            (us if name in us else xs)[name] = above(values)
        xs, us = self.restated.started(xs, us, self.shooting.times(durations))
        # Rows may have any sign: controls that say nothing count with both.
        sides = [{name: side * a for name, a in sizes.items()} for side in (1.0, -1.0)]
        points = [(xs, us), *((_sized(xs, own), _sized(us, own)) for own in sides)]
        ts, rows = self.shooting.times(durations), self._shown_at(points, params, durations)
        guess = self.reduced.extremes_of(np.concatenate(rows), self.path.shown, params) if rows else {}
        residuals = self.softened.values(self.conditions, xs, ts, params) if self.softened.slacks else {}
        guess = {**guess, **self.softened.start(residuals), **given}
        border = self.border.start(durations, params, guess, limits)
        flat = [np.zeros((count, 0)), *(us[c.name].reshape(count, -1) for c in self.dynamics.controls)]
        norms = self.norms.guess(_sized(us, sizes), {**params, **self.border.params(border)})
        slacks = self.norms.start(rows[0], list(self.path.shown), count) if self.norms.slacks else []
        return Point(xs, np.concatenate([*flat, *norms, *slacks], axis=1), border)

    def _shown_at(
        self, points: Sequence[tuple[dict[str, Array], dict[str, Array]]], params: Mapping[str, Array], durations: Array
    ) -> list[Array]:
        """The path rows as users wrote them of states and controls at nodes, where something has to fit them."""
        if not (self.reduced.extremes or self.norms.slacks):
            return []
        ts, rows = self.shooting.times(durations)[:-1], []
        norms = {c.name: np.zeros((self.nodes - 1, *c.shape)) for c in self.norms.controls}
        for xs, us in points:
            before = {name: a[:-1] for name, a in xs.items()}
            rows.append(np.asarray(self.shown_rows(ts, before, us | norms, dict(params))))
        return rows

    def given(self, ends: Ends, params: Mapping[str, Array], limits: Array) -> Given:
        """What a solve with these ends, parameters and limits of the border is for."""
        margins = np.zeros(len(self.shooting.exists))
        return Given(dict(params), self.filled(ends.final), limits, margins)

    def filled(self, values: Mapping[str, Array | None]) -> dict[str, Array]:
        """Values of the states, with anything where they are free."""
        found = {}
        for state in self.dynamics.states:
            value, rest = values[state.name], np.zeros(state.shape)
            if not state.group.flat:
                rest = np.asarray(state.group.identity(float))
            found[state.name] = rest if value is None else np.where(np.isnan(value), rest, value)
        return found

    def _prepared(self, params: Mapping[Any, Any] | None) -> dict[str, Array]:
        """All parameters as double-precision arrays, those of the objective and the final conditions too; checked."""
        valued = {leaf.name for leaf in (*self.dynamics.parameters, *self._own.values()) if leaf.value is not None}
        # A free parameter without a value starts in the middle of its box.
        middle = {box.name: control_guess(box, None, 1)[0] for box in self.border.boxes if box.name not in valued}
        given = middle | {name_of(key): value for key, value in (params or {}).items()}
        own = {name: given.pop(name) for name in self._own if name in given}
        with in_double():
            zeros_x = {s.name: np.zeros(s.shape) for s in self.dynamics.states}
            zeros_u = {c.name: np.zeros(c.shape) for c in self.dynamics.controls}
            families = ("rates", "constraints")
            inputs = self.dynamics._functions.prepare(0.0, zeros_x, zeros_u, given or None, reads=families)
            found = {name: np.asarray(value) for name, value in inputs.params.items()}
        for name, leaf in self._own.items():
            if name not in own and leaf.value is None:
                raise InputError(
                    f"the problem reads the parameter {name!r}, which has no value; pass params={{{name!r}: ...}}"
                )
            if name in self.by_node.leaves:
                found[name] = self.by_node.values(name, own.get(name, leaf.value))
                continue
            found[name] = reals(f"params[{name!r}]", own.get(name, leaf.value), InputError)
            if found[name].shape != leaf.shape:
                raise ShapeError(f"params[{name!r}] expects shape {leaf.shape}, got {found[name].shape}")
        for name, value in found.items():
            if not np.isfinite(value).all():
                raise InputError(f"params[{name!r}] expects finite numbers, got {value}")
        return found


def _sized(values: Mapping[str, Array], sizes: Mapping[str, Array]) -> dict[str, Array]:
    """Values by leaf, those that are nothing beside their sizes at these."""
    found = dict(values)
    for name, size in sizes.items():
        if name in found and np.abs(found[name]).max(initial=0.0) <= _NOTHING * np.abs(size).max(initial=0.0):
            found[name] = np.broadcast_to(size.reshape(found[name].shape[1:]), found[name].shape)
    return found
