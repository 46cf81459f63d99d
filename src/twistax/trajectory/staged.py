"""A transcribed problem as the solver's core has it: kernels of its rates, rows and ends, and points as flat arrays."""

from __future__ import annotations

import copy
import dataclasses
import functools
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy import ndarray as Array

from ..expr import Expr
from ..expr.transformations.without_numbers import Structure
from ..jax_inside import in_double
from ..solver.kernels import Argument, SmoothKernels
from ..solver.transcription import EQUALITY, INEQUALITY, NONE, JoinKernels, Method, Phase, PhaseKernels, Transcription
from .alike import Layout, group_key
from .conditions import Conditions
from .flat import Flat, Numbers
from .interval import simpson
from .joined import Join
from .shooting import Shooting
from .squares import Squares, SquaresBends, Term
from .transcribed import Given, Point, Segment, Transcribed
from .transcription import Collocation, MultipleShooting


def method_of(transcription: MultipleShooting | Collocation) -> Method:
    """The Runge-Kutta method of a transcription, with weights of the running cost."""
    tableau, substeps = transcription.tableau, transcription.substeps
    if isinstance(transcription, Collocation):
        a, b, c = tableau.a, tableau.b, tableau.c
        weights = np.concatenate([np.zeros(substeps + 1), np.tile(b / substeps, substeps)])
        return Method(a, b, c, substeps, True, weights)
    a, c = tableau.counted
    square = np.zeros((len(c), len(c)))
    for row, own in zip(square, a):
        row[: len(own)] = own
    weights = np.concatenate([simpson(substeps), np.zeros(substeps * len(c))])
    return Method(square, np.asarray(tableau.b[: len(c)]), np.asarray(c), substeps, False, weights)


#: A function of arguments, numbers of a solve and parameters.
_Traced = Callable[..., jax.Array]


class Functions:
    """The functions of a phase as kernels read them: of (eta, u, p), shares, points of nodes, and numbers.

    Numbers within expressions are arguments too: kernels of phases that differ in them alone are one.
    """

    def __init__(self, shooting: Shooting, numbers: Numbers, squares: Squares | None = None, order: int = 2) -> None:
        self._shooting, self._numbers, self._squares, self._order = shooting, numbers, squares, order
        self.point, self._layout = point_of(shooting), Layout(shooting, numbers)

    def smooth(
        self, function: _Traced, arguments: Mapping[Argument, int], order: int, key: Hashable, numbers: Array
    ) -> SmoothKernels:
        """Kernels of one of them that reads unknowns, numbers of a solve, and numbers within expressions last."""
        return SmoothKernels(function, arguments, order, key, numbers)

    def kernels(self, nodes: Mapping[int, Conditions]) -> PhaseKernels:
        """All of them, compiled."""
        own, n, g, data = self._shooting, self._shooting.n, self._shooting.border.size, self._numbers.size
        row = {Argument.ROW: own.by_node.width} if own.by_node.leaves else {}
        of_q = {Argument.Z: own.size, Argument.SHARE: 1, Argument.BASE: self.point.size, Argument.DATA: data, **row}
        of_node = {**of_q, Argument.Z: n + g}
        of_end = {Argument.Z: n + g, Argument.BASE: self.point.size, Argument.DATA: data, **row}
        gap = {Argument.Z: n, Argument.BASE: self.point.size, Argument.TARGET: self.point.size}
        boxes, group = self._layout.boxes, group_key(own)
        places = (tuple(own.layout.fixed), tuple(own.layout.end_states))
        at_end = ("end", boxes, *places, own.is_last and tuple(own.border.finite))
        made, pace = own.local.expressions, own.paced and (own.paced.start, own.paced.stop)
        conditions = [(k, self._of(self._node(c), of_node, [c.residuals], "node")) for k, c in nodes.items()]
        end = self._of(self._end, of_end, [made.conditions, made.rows, made.limits, made.final], at_end)
        rows = self._of(self._rows, of_q, [made.rows, made.limits, made.running], ("rows", pace, boxes))
        if self._squares is not None:
            bends = SquaresBends(own, self.point)
            self._add_squares(rows, bends.running, of_q, self._squares.running, ("running", pace))
            self._add_squares(end, bends.final, of_end, self._squares.final, "final")
        flat = all(factor.flat for factor in own.dynamics.group.factors.values())
        move = {Argument.Z: n, Argument.BASE: self.point.size}
        return PhaseKernels(
            self._of(self._rate, of_q, [made.rates], ("rate", pace)),
            rows,
            SmoothKernels(self._gap, gap, self._order, ("gap", group)),
            [*conditions, (own.intervals, end)],
            None if flat else SmoothKernels(self._retract, move, 0, ("retract", group)).kernels[0],
            None if flat else SmoothKernels(self._turn, {Argument.Z: n}, 0, ("turn", group)).kernels[0],
        )

    def _of(
        self,
        function: _Traced,
        arguments: Mapping[Argument, int],
        parts: Sequence[Sequence[Expr]],
        rest: Hashable,
        order: int | None = None,
    ) -> SmoothKernels:
        """The kernels of a function of (arguments, all parameters, expressions).

        Args:
            parts: the expressions, in groups.
            rest: what it depends on beside these and the layout.
            order: of the derivatives, if not as in the whole problem.
        """
        structure = Structure([expr for part in parts for expr in part], self._layout.token)

        def traced(*given: jax.Array) -> jax.Array:
            known, roots = dict(zip([*arguments, Argument.NUMBERS], given)), iter(structure.roots)
            params = self._numbers.params(known[Argument.DATA])
            if Argument.NUMBERS in known:
                params |= structure.params(known.pop(Argument.NUMBERS))
            if Argument.ROW in known:
                at = known.get(Argument.SHARE, jnp.ones(1))[0]
                params |= self._shooting.by_node.at(known.pop(Argument.ROW), at)
            exchanged = [tuple(next(roots) for _ in part) for part in parts]
            return function(*known.values(), params, *exchanged)

        by_node = tuple(leaf.shape for leaf in self._shooting.by_node.leaves.values())
        key = (self._layout.key, by_node, structure.key, tuple(map(len, parts)), rest)
        return self.smooth(traced, arguments, self._order if order is None else order, key, structure.numbers)

    def _add_squares(
        self,
        to: SmoothKernels,
        function: _Traced,
        arguments: Mapping[Argument, int],
        terms: Sequence[Term],
        rest: Hashable,
    ) -> None:
        """Put second derivatives of squares where those of the whole function stand."""
        if terms:
            arguments = {**arguments, Argument.WEIGHTS: to.rows}
            to.kernels += self._of(function, arguments, list(zip(*terms)), ("squares", rest), 0).kernels

    def _made_of(self, **exprs: tuple[Expr, ...]) -> Shooting:
        """The phase with other expressions."""
        local = self._shooting.local
        return self._shooting.by(local.made_of(local.expressions._replace(**exprs)))

    def _rate(self, q: jax.Array, share: jax.Array, base: jax.Array, _: Any, params: Any, rates: Any) -> jax.Array:
        return self._made_of(rates=rates).rate_at(q, share[0], self.point.split(base), params)

    def _rows(
        self, q: jax.Array, share: jax.Array, base: jax.Array, _: Any, params: Any, rows: Any, limits: Any, running: Any
    ) -> jax.Array:
        own = self._made_of(rows=rows, limits=limits, running=running)
        return own.point_at(q, share[0], self.point.split(base), params)

    def _gap(self, eta: jax.Array, base: jax.Array, target: jax.Array) -> jax.Array:
        return self._shooting.local.gap(eta, self.point.split(base), self.point.split(target))

    def _end(self, z: jax.Array, base: jax.Array, data: jax.Array, params: Any, *exprs: Any) -> jax.Array:
        own = self._made_of(**dict(zip(("conditions", "rows", "limits", "final"), exprs, strict=True)))
        none, numbers = jnp.zeros(own.border.size, z.dtype), self._numbers
        given = Given(params, numbers.final(data, own.phase), numbers.limits(data))
        return own.end_at(z, (self.point.split(base), none), given)

    def _node(self, conditions: Conditions) -> _Traced:
        def at_node(z: jax.Array, share: jax.Array, base: jax.Array, _: Any, params: Any, residuals: Any) -> jax.Array:
            own = self._shooting
            b, x = z[own.n :], own.dynamics.group.retract(self.point.split(base), z[: own.n])
            begin, length = own.span(b)
            asked = dataclasses.replace(conditions, residuals=residuals)
            return asked.values(begin + share[0] * length, x, params | own.border.params(b))

        return at_node

    def _retract(self, d: jax.Array, base: jax.Array) -> jax.Array:
        moved = self._shooting.dynamics.group.retract(self.point.split(base), d)
        return jnp.concatenate([moved[name].reshape(-1) for name in self.point.shapes])

    def _turn(self, c: jax.Array) -> jax.Array:
        return self._shooting.dynamics.group.left_jacobian(c).reshape(-1)

    def join(self, join: Join, after: Shooting) -> JoinKernels:
        """The kernels of a join to the next phase."""
        before, numbers, first = self._shooting, self._numbers, point_of(after)

        def gap(z: Any, base: Any, target: Any, data: Any, params: Any, sources: Any) -> jax.Array:
            here = (self.point.split(base), jnp.zeros(before.border.size, z.dtype))
            given = numbers.initial(data, after.phase)
            return join.made_of(sources).gap_at(z, here, first.split(target), given, params)

        arguments = {Argument.Z: before.n + before.border.size, Argument.BASE: self.point.size}
        arguments |= {Argument.TARGET: first.size, Argument.DATA: numbers.size}
        rest = ("join", group_key(after), after.phase, join.key)
        return JoinKernels(self._of(gap, arguments, [join.sources], rest), join.free)


def point_of(shooting: Shooting) -> Flat:
    """A node's states as one vector."""
    return Flat({name: shooting.leaves[name].shape for name in shooting.dynamics.group.factors})


class Bounds(NamedTuple):
    """Rows that are limits of single unknowns: the core takes these as bounds.

    Attributes:
        rows: places among all rows of the phase.
        stages, columns: where the unknown stands, column n + m + i for entry i of the border.
        upper: whether it is an upper limit.
        limits: of leaves; NaN where it is that of a time or of a free parameter.
    """

    rows: Array
    stages: Array
    columns: Array
    upper: Array
    limits: Array


class Part:
    """A phase of a staged problem.

    Attributes:
        shooting: the phase.
        stages: its stages among all, the last one of the next phase's join.
        bounds: its rows that are limits of single unknowns.
        phase: for the core.
    """

    def __init__(
        self,
        segment: Segment,
        conditions: Mapping[int, Conditions],
        method: Method,
        kernels: PhaseKernels,
        join: JoinKernels | None,
        node_rows: tuple[int, int],
    ) -> None:
        self._node_rows = node_rows
        self.shooting = shooting = segment.shooting
        self.stages = slice(segment.nodes.start, segment.nodes.stop)
        self.point = point_of(shooting)
        self._conditions, self._join, self._method, self._kernels = conditions, join, method, kernels
        self.describe()

    def describe(self) -> None:
        """Say again which rows there are."""
        shooting = self.shooting
        self.bounds = bounds_of_rows(shooting)
        kinds = np.where(shooting.exists, np.where(shooting.equality, EQUALITY, INEQUALITY), NONE)
        kinds[self.bounds.rows] = NONE
        path, rows = self.by_place(kinds)
        self.phase = Phase(
            shooting.n,
            shooting.m,
            self.point.size,
            self._method,
            self._kernels,
            shooting.mesh.shares[:-1],
            shooting.mesh.widths,
            path,
            rows,
            np.zeros(path.shape),
            [np.zeros(len(own)) for own in rows],
            self._join,
            self._node_rows,
        )

    def by_place(self, rows: Array) -> tuple[Array, list[Array]]:
        """Numbers for all rows of the phase as those of path rows at their points, and of the conditions at nodes."""
        layout, K = self.shooting.layout, self.shooting.intervals
        inner, end = np.split(rows, [K * layout.per_interval])
        inner = inner.reshape(K, -1)
        path = np.zeros((K, (self.shooting.substeps + 1) * layout.path_rows), rows.dtype)
        path[:, layout.asked] = inner[:, : len(layout.asked)]
        path = path.reshape(K, self.shooting.substeps + 1, layout.path_rows)[:, :, : len(self.shooting.path.names)]
        return path, [*(inner[k, len(layout.asked) :][: layout.counts[k]] for k in self._conditions), end]

    def rows(self, h: Array, e: Array, path_places: Array, node_places: Sequence[Array]) -> Array:
        """Numbers of inequalities and equalities as those of all rows of the phase, zero where none is."""
        found = np.zeros(len(self.shooting.exists))
        nodes = [_chosen(h, e, *both) for both in zip(node_places, self.phase.conditions)]
        self.write(found, _chosen(h, e, path_places, self.phase.path), nodes)
        return found

    def write(self, rows: Array, path: Array, nodes: Sequence[Array]) -> None:
        """Write numbers of path rows at their points, and of the conditions of nodes, among all rows of the phase."""
        layout, K = self.shooting.layout, self.shooting.intervals
        inner = rows[: K * layout.per_interval].reshape(K, -1)
        if path.size:
            inner[:, : len(layout.asked)] = path.reshape(K, -1)[:, layout.asked]
        *others, rows[K * layout.per_interval :] = nodes
        for (k, _), values in zip(self.phase.kernels.nodes, others):
            inner[k, len(layout.asked) :][: len(values)] = values


class Staged:
    """A problem for the core.

    Args:
        transcribed: the discrete problem.
        parts: the problems of its phases.
        given: what it is solved for, for shapes.

    Attributes:
        parts: its phases.
        transcription: functions and sizes.
    """

    def __init__(self, transcribed: Transcribed, parts: Sequence[Any], given: Given) -> None:
        self.transcribed, self.border = transcribed, transcribed.border
        by_node = [part.shooting.by_node for part in parts]
        self.numbers = Numbers([point_of(part.shooting) for part in parts], given, by_node)
        self.parts: list[Part] = []
        with in_double():
            every = [Functions(part.shooting, self.numbers, part.squares, part.order) for part in parts]
            pairs = zip(every, transcribed.joins, parts[1:])
            joins = [functions.join(join, after.shooting) for functions, join, after in pairs]
            for segment, part, functions, join in zip(transcribed.segments, parts, every, [*joins, None]):
                rows = dict(part.node_rows)
                of_nodes = self.numbers.node_rows(len(self.parts))
                kernels = functions.kernels(rows)
                self.parts.append(Part(segment, rows, method_of(part.transcription), kernels, join, of_nodes))
        self._assemble(given)

    def _assemble(self, given: Given) -> None:
        phases = [part.phase for part in self.parts]
        self.transcription = Transcription(phases, self.border.size, self.numbers.vector(given))
        stages = self.transcription.stages
        widths = np.array(stages.states) + np.array(stages.controls)
        #: Where the unknowns of each stage begin in v.
        self.first = np.cumsum(widths) - widths
        self._margins = np.zeros(len(self.transcribed.exists))

    def drop(self, rows: Sequence[Array], given: Given) -> None:
        """Take rows out of each phase that others decide; they are only checked."""
        self.transcribed.drop(rows)
        for part in self.parts:
            part.describe()
        self._assemble(given)

    def alone(self, given: Given) -> Staged:
        """The same for another thread: kernels are shared, memory is not."""
        found = copy.copy(self)
        found._assemble(given)
        return found

    def set_given(self, given: Given) -> None:
        """What it is solved for from now on."""
        self.transcription.set_data(self.numbers.vector(given))
        self._margins = np.broadcast_to(np.asarray(given.margins), self._margins.shape)
        for number, (part, segment) in enumerate(zip(self.parts, self.transcribed.segments)):
            rows = self.transcribed.rows_of(segment, self._margins)
            self.transcription.set_margins(number, *part.by_place(rows))

    # ---- points ---------------------------------------------------------------------------------------------------

    def flat(self, point: Point) -> Array:
        """z of a point."""
        return self._joined(point, [part.point.joined(xs, 1) for part, xs in self._each(point)])

    def coordinates(self, point: Point) -> Array:
        """v of a point: states that are flat, controls and shared unknowns as they are, others zero."""
        found = []
        for part, xs in self._each(point):
            own = part.shooting
            d = np.zeros((own.nodes, own.n))
            for name, columns in own.dynamics.group.slices.items():
                if own.dynamics.group.factors[name].flat:
                    d[:, columns] = np.reshape(xs[name], (own.nodes, -1))
            found.append(d)
        return self._joined(point, found)

    def point(self, z: Array) -> Point:
        """The point of z."""
        stages, own = self.transcription.stages, self.transcribed
        us, xs = np.zeros((own.intervals, own.m)), []
        at = 0
        for part in self.parts:
            rows, size, m = self._rows_of(part), part.point.size, part.shooting.m
            body = z[at : at + (size + m) * part.shooting.intervals].reshape(-1, size + m)
            us[rows, :m] = body[:, size:]
            at += body.size
            xs.append(part.point.split(np.concatenate([body[:, :size], z[None, at : at + size]])))
            at += size
            if count := stages.controls[rows.stop]:
                us[rows.stop, :count] = z[at : at + count]
                at += count
        return Point(xs[0] if own.segments[0].alone else tuple(xs), us, z[at:])

    def _each(self, point: Point) -> list[tuple[Part, Any]]:
        alone = self.transcribed.segments[0].alone
        return list(zip(self.parts, [point.xs] if alone else point.xs))

    def _joined(self, point: Point, nodes: Sequence[Array]) -> Array:
        """Numbers of nodes, of each phase (nodes, ...), controls, and the border, in the order of stages."""
        controls, us = self.transcription.stages.controls, np.asarray(point.us)
        found = []
        for part, own in zip(self.parts, nodes):
            rows = self._rows_of(part)
            body = np.concatenate([own[:-1], us[rows, : part.shooting.m]], axis=1)
            found += [
                body.ravel(),
                own[-1],
                us[rows.stop, : controls[rows.stop]] if controls[rows.stop] else own[:0, 0],
            ]
        return np.concatenate([*found, np.ravel(point.border)])

    @staticmethod
    def _rows_of(part: Part) -> slice:
        """The intervals of a phase among all stages."""
        return slice(part.stages.start, part.stages.start + part.shooting.intervals)

    # ---- limits ---------------------------------------------------------------------------------------------------

    @property
    def bound_places(self) -> list[Array]:
        """Where the bounds of each phase stand in v."""
        stages, found = self.transcription.stages, []
        for part in self.parts:
            bounds, width = part.bounds, part.shooting.n + part.shooting.m
            shared = stages.variables - stages.parameters + bounds.columns - width
            own = self.first[part.stages.start + bounds.stages] + bounds.columns
            found.append(np.where(np.isnan(bounds.limits), shared, own))
        return found

    @property
    def turning(self) -> Array:
        """Which entries of v are rotations."""
        found = np.zeros(self.transcription.stages.variables, bool)
        for part in self.parts:
            at = self.first[part.stages][:, None] + np.flatnonzero(part.shooting.turns)
            found[at.ravel()] = True
        return found

    @functools.cached_property
    def curved(self) -> Array:
        """Which entries of z are of states on manifolds that are not flat."""
        nodes = []
        for part in self.parts:
            own = part.shooting
            row = {n: np.full(shape, not own.dynamics.group.factors[n].flat) for n, shape in part.point.shapes.items()}
            nodes.append(np.tile(part.point.joined(row), (own.nodes, 1)))
        us = np.zeros((self.transcribed.intervals, self.transcribed.m))
        return self._joined(Point(None, us, np.zeros(self.border.size)), nodes) != 0.0

    def limits(self, point: Point, given: Given) -> tuple[Array, Array]:
        """Lower and upper bounds of v; equal where an entry is fixed."""
        v = self.coordinates(point)
        lower, upper = np.full(len(v), -np.inf), np.full(len(v), np.inf)
        border = len(v) - self.border.size
        lower[border:], upper[border:] = np.asarray(given.limits).T
        for part, segment, places in zip(self.parts, self.transcribed.segments, self.bound_places):
            of_leaf = ~np.isnan(part.bounds.limits)
            for bound, side, most in ((lower, False, np.maximum), (upper, True, np.minimum)):
                at = of_leaf & (part.bounds.upper == side)
                margins = self.transcribed.rows_of(segment, self._margins)[part.bounds.rows[at]]
                most.at(bound, places[at], part.bounds.limits[at] + (-margins if side else margins))
        start = self.parts[0].shooting
        fixed = np.flatnonzero(~start.free.d[0])
        lower[fixed] = upper[fixed] = v[: start.n][fixed]
        return lower, upper

    # ---- rows -----------------------------------------------------------------------------------------------------

    def all_rows(self, h: Array, e: Array, lower: Array, upper: Array) -> Array:
        """Numbers of inequalities, of equalities and of both sides of v as those of all rows."""
        found = []
        places = zip(self.transcription.path_places, self.transcription.node_places, self.bound_places)
        for part, (path, nodes, bounds) in zip(self.parts, places):
            rows = part.rows(h, e, path, nodes)
            rows[part.bounds.rows] = np.where(part.bounds.upper, upper[bounds], lower[bounds])
            found.append(rows)
        return self.transcribed.whole_rows(found)

    def split_rows(self, rows: Array) -> tuple[Array, Array, Array, Array]:
        """Numbers of all rows as those of inequalities, of equalities, of lower and of upper bounds."""
        stages = self.transcription.stages
        counts = (sum(stages.inequalities), sum(stages.equalities), stages.variables, stages.variables)
        h, e, lower, upper = (np.zeros(count) for count in counts)
        every = zip(self.transcription.path_places, self.transcription.node_places, self.bound_places)
        for part, segment, (path, nodes, bounds) in zip(self.parts, self.transcribed.segments, every):
            own = self.transcribed.rows_of(segment, rows)
            of_path, of_nodes = part.by_place(own)
            kinds = [part.phase.path, *part.phase.conditions]
            for places, kind, values in zip([path, *nodes], kinds, [of_path, *of_nodes]):
                h[places[kind == INEQUALITY]] = values[kind == INEQUALITY]
                e[places[kind == EQUALITY]] = values[kind == EQUALITY]
            for side, to in ((True, upper), (False, lower)):
                at = part.bounds.upper == side
                to[bounds[at]] = own[part.bounds.rows[at]]
        return h, e, lower, upper

    def after(self, v: Array) -> Array:
        """Of numbers of v those of the states after each interval, as defects have them."""
        states, first = self.transcription.stages.states, self.first
        return np.concatenate([v[first[k] : first[k] + states[k]] for k in range(1, len(states))])

    def step(self, d: Array, u: Array, border: Array) -> Array:
        """v of a step, d (nodes, n) and u (intervals, m) padded."""
        nodes = [d[part.stages, : part.shooting.n] for part in self.parts]
        return self._joined(Point(None, u, border), nodes)

    @property
    def stages_of_rows(self) -> tuple[Array, Array]:
        """The stage of every inequality and of every equality."""
        stages = self.transcription.stages
        every = np.arange(len(stages.states))
        return np.repeat(every, stages.inequalities), np.repeat(every, stages.equalities)

    def places_alone(self) -> Iterator[tuple[Array, Array]]:
        """Places of inequalities and equalities, of which no two stand in one stage; together they are all."""
        stages, none = self.stages_of_rows, np.zeros(0, int)
        numbers = [np.arange(len(own)) - np.searchsorted(own, own) for own in stages]
        for k in range(int(numbers[0].max(initial=-1)) + 1):
            yield np.flatnonzero(numbers[0] == k), none
        for k in range(int(numbers[1].max(initial=-1)) + 1):
            yield none, np.flatnonzero(numbers[1] == k)

    def levelled_rows(self, inequalities: Array, equalities: Array) -> tuple[Array, Array]:
        """Sizes of rows: of a path row the largest of all its places; 1 where there is none."""
        sizes = [np.where(np.isfinite(a) & (a > 0.0), a, 0.0) for a in (inequalities, equalities)]
        for part, every in zip(self.parts, self.transcription.path_places):
            for row in range(part.phase.path.shape[2]):
                for kind, own in zip((INEQUALITY, EQUALITY), sizes):
                    places = every[..., row][part.phase.path[..., row] == kind]
                    own[places] = own[places].max(initial=0.0)
        return sizes[0] + (sizes[0] == 0.0), sizes[1] + (sizes[1] == 0.0)


def _chosen(h: Array, e: Array, places: Array, kinds: Array) -> Array:
    """Of each place the number among inequalities or equalities; zero where it is neither."""
    found = np.zeros(places.shape)
    for kind, values in ((INEQUALITY, h), (EQUALITY, e)):
        found[kinds == kind] = values[places[kinds == kind]]
    return found


def bounds_of_rows(shooting: Shooting) -> Bounds:
    """Which rows of a phase are limits of states at nodes, of controls, of times and of free parameters."""
    own, layout, K = shooting, shooting.layout, shooting.intervals
    first_box = len(own.path.names) - len(own.path.bounds)
    found: list[tuple[int, int, int, bool, float]] = []

    def add(row: int, path_row: int, stage: int) -> None:
        if path_row < first_box or not own.exists[row]:
            return
        bound, group = own.path.bounds[path_row - first_box], own.dynamics.group
        if bound.leaf not in group.slices:
            column = own.n + own.local.controls.slices[bound.leaf].start + bound.entry
        elif group.factors[bound.leaf].flat:
            column = group.slices[bound.leaf].start + bound.entry
        else:
            return
        found.append((row, stage, column, bound.sign > 0.0, bound.limit))

    for k in range(K):
        for place, row in enumerate(layout.asked):
            if row < len(own.path.names):
                add(k * layout.per_interval + place, int(row), k)
    limits = own.border.finite if own.is_last else []
    first = len(own.exists) - len(limits) - len(layout.end_states)
    for place, row in enumerate(layout.end_states):
        add(first + place, int(row), K)
    for row, (entry, side) in zip(range(len(own.exists) - len(limits), len(own.exists)), limits):
        if own.exists[row]:
            found.append((row, K, own.n + own.m + entry, bool(side), np.nan))
    kinds = (int, int, int, bool, float)
    return Bounds(*(np.array(a, kind) for a, kind in zip(zip(*found) if found else ((),) * 5, kinds)))
