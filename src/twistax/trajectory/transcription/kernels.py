"""The functions of a phase as compiled kernels for the solver's core. Phases that differ
only in numbers share kernels.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from numpy import ndarray as Array

from ...expr import Control, Expr, Leaf, Parameter, State, Time, leaves_of
from ...expr.fields import freeze
from ...expr.transformations.without_numbers import Structure
from ...solver.kernels import Argument, SmoothKernels
from ...solver.transcription import JoinKernels, PhaseKernels
from ..problem.conditions import Conditions
from .iterate import Instance
from .joined import Join
from .shooting import Shooting
from .vectors import Flat, Numbers

#: The arguments of a kernel, by kind.
Known = Mapping[Argument, jax.Array]
#: A function of arguments and parameters, with groups of expressions as results.
Traced = Callable[[Known, Any, Sequence[Any]], jax.Array]


class ExtraHessian(NamedTuple):
    """Second derivatives that replace the exact ones, for example those of a sum of squares.

    Attributes:
        running, final: of the running cost with respect to q = [eta, u, b], and of the final cost with respect to z =
            [eta, b]; flat.
        running_parts, final_parts: the expressions that they read, in groups.
    """

    running: Traced
    running_parts: Sequence[Sequence[Expr]]
    final: Traced
    final_parts: Sequence[Sequence[Expr]]


def point_of(shooting: Shooting) -> Flat:
    """A node's states as one vector."""
    return Flat({name: shooting.leaves[name].shape for name in shooting.dynamics.group.factors})


def group_key(shooting: Shooting) -> Hashable:
    """A key that is equal for phases whose states have the same groups."""
    return tuple((type(group), freeze(group), group.shape) for group in shooting.dynamics.group.factors.values())


class _LeafPlaces:
    """The index ranges of a phase's leaves in the arguments of kernels, independent of their names.

    Attributes:
        key: equal for phases whose points, controls, parameters and times have the same layout.
        boxes: the kinds of limits of each leaf.
    """

    def __init__(self, shooting: Shooting, numbers: Numbers) -> None:
        local, border = shooting.local, shooting.border
        kinds = {
            "parameter": numbers.names,
            "free": [box.name for box in border.boxes],
            "row": shooting.by_node.leaves,
            "state": local.group.factors,
            "control": local.controls.slices,
        }
        self._places = {name: (kind, k) for kind, names in kinds.items() for k, name in enumerate(names)}
        self.boxes = tuple((self._places[b.leaf], b.entry, b.sign) for b in shooting.path.bounds)
        controls = tuple(part.stop - part.start for part in local.controls.slices.values())
        free = tuple(box.shape for box in border.boxes)
        shared = (free, tuple(border.unknown[: border.phases]))
        self.key = (group_key(shooting), controls, *shared, numbers.key, local.sign)

    def token(self, leaf: Leaf) -> Hashable:
        """The token that represents a leaf in a key; None if all properties of the leaf count."""
        if isinstance(leaf, Time):
            return "time"
        known = isinstance(leaf, (State, Control, Parameter)) and leaf.name in self._places
        return (type(leaf), self._places[leaf.name], leaf.shape) if known else None


class PhaseFunctions:
    """The functions of a phase: of (eta, u, p), fractions of the duration, points of nodes, and the numbers of a solve.

    Numbers within expressions are arguments too, so phases that differ only in these share kernels.

    Args:
        extra: second derivatives of the costs, if those of the cost functions are not compiled.
        order: the order of the derivatives that are compiled.
    """

    def __init__(self, shooting: Shooting, numbers: Numbers, extra: ExtraHessian | None = None, order: int = 2) -> None:
        self._shooting, self._numbers, self._extra, self._order = shooting, numbers, extra, order
        self.point, self._leaf_places = point_of(shooting), _LeafPlaces(shooting, numbers)
        self._block = numbers.of_phase(shooting.phase)

    def smooth(
        self,
        function: Callable[..., jax.Array],
        arguments: Mapping[Argument, int],
        order: int,
        key: Hashable,
        numbers: Array,
    ) -> SmoothKernels:
        """Kernels of a function whose arguments are unknowns, the numbers of a solve, and last the numbers within
        expressions.
        """
        return SmoothKernels(function, arguments, order, key, numbers)

    def kernels(self, nodes: Mapping[int, Conditions]) -> PhaseKernels:
        """All kernels, compiled."""
        phase, exprs, group = self._shooting, self._shooting.local.expressions, group_key(self._shooting)
        n, of_step, size = phase.n, phase.n + phase.border.unknowns, self.point.size
        fixed = {Argument.BASE: size, Argument.DATA: self._numbers.size}
        if phase.border.phases > 1:
            fixed[Argument.PHASE] = self._block.stop - self._block.start
        if phase.by_node.leaves:
            fixed[Argument.ROW] = phase.by_node.width
        of_q = {Argument.Z: phase.size, Argument.SHARE: 1, **fixed}
        of_node, of_end = {Argument.Z: of_step, Argument.SHARE: 1, **fixed}, {Argument.Z: of_step, **fixed}
        boxes, pace = self._leaf_places.boxes, phase.paced and (phase.paced.start, phase.paced.stop)
        limits = tuple(phase.border.finite) if phase.is_last else ()
        end = self._of(
            self._end,
            of_end,
            [exprs.conditions, exprs.rows, exprs.limits, exprs.final],
            ("end", boxes, tuple(phase.layout.fixed), tuple(phase.layout.end_states), limits),
            all_durations=bool(limits),
        )
        rows = self._of(self._rows, of_q, [exprs.rows, exprs.limits, exprs.running], ("rows", pace, boxes))
        if (extra := self._extra) is not None:
            self._add(rows, extra.running, of_q, extra.running_parts, ("running", pace))
            self._add(end, extra.final, of_end, extra.final_parts, "final")
        flat = all(factor.flat for factor in phase.dynamics.group.factors.values())
        gap = {Argument.Z: n, Argument.BASE: size, Argument.TARGET: size}
        move = {Argument.Z: n, Argument.BASE: size}
        return PhaseKernels(
            self._of(self._rate, of_q, [exprs.rates], ("rate", pace)),
            rows,
            SmoothKernels(self._gap, gap, self._order, ("gap", group)),
            [
                *((k, self._of(self._node(c), of_node, [c.residuals], "node")) for k, c in nodes.items()),
                (phase.intervals, end),
            ],
            None if flat else SmoothKernels(self._retract, move, 0, ("retract", group)).kernels[0],
            None if flat else SmoothKernels(self._turn, {Argument.Z: n}, 0, ("turn", group)).kernels[0],
        )

    def join(self, join: Join, after: Shooting) -> JoinKernels:
        """The kernels of a join to the next phase."""
        before, first = self._shooting, point_of(after)

        def gap(known: Known, params: Any, parts: Sequence[Any]) -> jax.Array:
            # The numbers of the next phase, which begin with its initial states, follow those of this phase.
            start, initial = first.split(known[Argument.TARGET]), first.split(known[Argument.PHASE][-first.size :])
            return join.gap_at(parts[0], known[Argument.Z], self._base(known), start, initial, params)

        arguments = {Argument.Z: before.n + before.border.unknowns, Argument.BASE: self.point.size}
        arguments |= {Argument.TARGET: first.size, Argument.DATA: self._numbers.size}
        arguments |= {Argument.PHASE: self._block.stop - self._block.start + first.size}
        rest = ("join", group_key(after), join.key)
        return JoinKernels(self._of(gap, arguments, [join.sources], rest), join.free)

    def _of(
        self,
        function: Traced,
        arguments: Mapping[Argument, int],
        parts: Sequence[Sequence[Expr]],
        rest: Hashable,
        order: int | None = None,
        *,
        all_durations: bool = False,
    ) -> SmoothKernels:
        """The kernels of one function.

        Args:
            parts: the expressions, in groups.
            rest: everything else that the function depends on, except for the layout.
            order: the order of the derivatives, if it differs from that of the problem.
            all_durations: whether the function reads the durations of all phases.
        """
        every = [expr for part in parts for expr in part]
        structure = Structure(every, self._leaf_places.token)
        by_node, border = self._shooting.by_node, self._shooting.border
        of_all = all_durations or self._depends_on_place(every)

        def traced(*arrays: jax.Array) -> jax.Array:
            known, roots = dict(zip([*arguments, Argument.NUMBERS], arrays)), iter(structure.roots)
            params, z = self._numbers.params(known[Argument.DATA]), known[Argument.Z]
            stage, shared = jnp.split(z, [len(z) - border.unknowns])
            known[Argument.Z] = jnp.concatenate([stage, self._durations(shared, known, of_all)])
            if Argument.NUMBERS in known:
                params |= structure.params(known[Argument.NUMBERS])
            if Argument.ROW in known:
                params |= by_node.at(known[Argument.ROW], known.get(Argument.SHARE, jnp.ones(1))[0])
            return function(known, params, [tuple(next(roots) for _ in part) for part in parts])

        shapes = tuple(leaf.shape for leaf in by_node.leaves.values())
        of_phase = self._shooting.phase if of_all else None
        key = (self._leaf_places.key, shapes, structure.key, tuple(map(len, parts)), rest, of_phase)
        return self.smooth(traced, arguments, self._order if order is None else order, key, structure.numbers)

    def _add(
        self,
        kernels: SmoothKernels,
        function: Traced,
        arguments: Mapping[Argument, int],
        parts: Sequence[Sequence[Expr]],
        rest: Hashable,
    ) -> None:
        """Append a kernel of second derivatives."""
        if parts:
            arguments = {**arguments, Argument.WEIGHTS: kernels.rows}
            kernels.kernels += self._of(function, arguments, parts, ("squares", rest), 0).kernels

    def _depends_on_place(self, exprs: Sequence[Expr]) -> bool:
        """Whether a function depends on the number of its phase: by the place of its duration among the unknowns, or by
        the time at which the phase starts.
        """
        phase, border = self._shooting, self._shooting.border
        is_unknown = bool(border.unknown[phase.phase])
        return border.phases == 1 or is_unknown or any(isinstance(leaf, Time) for leaf in leaves_of(*exprs))

    # ---- functions that are traced -----------------------------------------------------------------------------------

    def _durations(self, shared: jax.Array, known: Known, of_all: bool) -> jax.Array:
        """The durations of all phases, then the free parameters. Durations that are not read are NaN."""
        border, phase = self._shooting.border, self._shooting.phase
        if of_all:
            return border.complete(shared, self._numbers.limits(known[Argument.DATA]))
        unread = jnp.full(border.phases, jnp.nan, shared.dtype)
        duration = known[Argument.PHASE][2 * self.point.size :][:1]
        of_free = shared[int(border.unknown[: border.phases].sum()) :]
        return jnp.concatenate([unread[:phase], duration, unread[phase + 1 :], of_free])

    def _base(self, known: Known) -> dict[str, jax.Array]:
        return self.point.split(known[Argument.BASE])

    def _rate(self, known: Known, params: Any, parts: Sequence[Any]) -> jax.Array:
        phase = self._shooting.made_of(rates=parts[0])
        return phase.rate_at(known[Argument.Z], known[Argument.SHARE][0], self._base(known), params)

    def _rows(self, known: Known, params: Any, parts: Sequence[Any]) -> jax.Array:
        phase = self._shooting.made_of(**dict(zip(("rows", "limits", "running"), parts, strict=True)))
        return phase.point_at(known[Argument.Z], known[Argument.SHARE][0], self._base(known), params)

    def _end(self, known: Known, params: Any, parts: Sequence[Any]) -> jax.Array:
        phase = self._shooting.made_of(**dict(zip(("conditions", "rows", "limits", "final"), parts, strict=True)))
        z, data, numbers = known[Argument.Z], known[Argument.DATA], self._numbers
        block = known[Argument.PHASE] if Argument.PHASE in known else data[self._block]
        size = self.point.size
        instance = Instance(params, self.point.split(block[size : 2 * size]), numbers.limits(data))
        return phase.end_at(z, (self._base(known), jnp.zeros(phase.border.size, z.dtype)), instance)

    def _node(self, conditions: Conditions) -> Traced:
        def at_node(known: Known, params: Any, parts: Sequence[Any]) -> jax.Array:
            d, b = jnp.split(known[Argument.Z], [self._shooting.n])
            exchanged = dataclasses.replace(conditions, residuals=parts[0])
            share, base = known[Argument.SHARE][0], self._base(known)
            return self._shooting.condition_at(exchanged, d, share, base, b, params)

        return at_node

    def _gap(self, eta: jax.Array, base: jax.Array, target: jax.Array) -> jax.Array:
        return self._shooting.local.gap(eta, self.point.split(base), self.point.split(target))

    def _retract(self, d: jax.Array, base: jax.Array) -> jax.Array:
        states = self._shooting.dynamics.group.retract(self.point.split(base), d)
        return jnp.concatenate([states[name].reshape(-1) for name in self.point.shapes])

    def _turn(self, c: jax.Array) -> jax.Array:
        return self._shooting.dynamics.group.left_jacobian(c).reshape(-1)
