"""A statement with linear controls and free node times, restated with held controls and nodes at given shares.

A linear control becomes a state with a held rate. With free node times, interval k is s_k times as long as its share of
the final time says: a held control, the pace s, multiplies all rates and the running cost, and time becomes a state
with rate 1, which ends at the final time. So both keep the problem in stages.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from numpy import ndarray as Array

from ..expr import Constraint, Control, Expr, Norm, State, Time, leaves_of
from ..expr.graph import substitute
from ..lowering import Dynamics, compile
from ..system import System
from .cones import norm_controls
from .controls import Linear, Rate, linear_controls
from .mesh import Mesh
from .statement import Objective

#: Names of what free node times add.
_CLOCK, _PACE = "time of the node", "pace of the interval"


class Restated:
    """What a problem is with held controls and nodes at given shares.

    Args:
        dynamics, objective: as stated.
        controls: how controls go on between nodes.
        first: whether the path begins here, and not with another phase.
        added: names of controls that users do not see.

    Attributes:
        dynamics, objective: restated.
        controls: those of the system as stated, without rates.
        straight: names of the states that are linear over each interval.
        at_end: constraints on the last node that come with free node times.
        at_join: state -> what it begins as after another phase, of the end of that.

    Raises:
        ModelError: see `linear_controls`.
    """

    def __init__(
        self,
        dynamics: Dynamics,
        objective: Objective,
        controls: Any,
        mesh: Mesh,
        first: bool,
        added: Collection[str] = (),
    ) -> None:
        linear = linear_controls(controls, dynamics.controls)
        rates = {Rate(c).name for c in dynamics.controls}
        self.controls = [c for c in dynamics.controls if c.name not in rates]
        self._added = frozenset(added)
        self._mesh, self._linear = mesh, {c.name: c for c in self.controls if c.name in linear}
        self.dynamics, self.objective = dynamics, objective
        self.at_end: dict[str, Constraint] = {}
        self.at_join: dict[str, Expr] = {}
        self._states: dict[str, State] = {}
        self._rates: dict[str, Control] = {}
        #: Names of the held controls that are rates of linear ones.
        self.rates: set[str] = set()
        self._exchange: dict[str, Expr] = {}
        rows: dict[str, Constraint] = {}
        if linear:
            running, bounds = _with_bounds(objective, set(linear))
            self._linear |= {s.name: s for s, _ in bounds}
            rows = {s.name: Norm(a) <= s for s, a in bounds}
            self.objective = type(objective)(objective.final, running=running)
            for name, leaf in self._linear.items():
                self._add(leaf, linear.get(name, Linear()))
        clock = State(_CLOCK, initial=0.0 if first else None)
        if mesh.free is not None:
            self._exchange[Time().key()] = clock
            self.at_end = {"the last node is at the final time": clock == Time()}
            self.at_join = {_CLOCK: Time()}
        self.straight = set(self._linear)
        #: States that the system as stated does not have.
        self.hidden = self.straight | ({_CLOCK} if mesh.free is not None else set())
        if self._states or mesh.free is not None:
            final, running = self.objective.final, self.objective.running
            self.objective = type(objective)(
                None if final is None else self._put(final, last=True),
                running=None if running is None else self._put(running),
            )
            self.dynamics = self._compiled(dynamics, rows, clock)

    def _add(self, leaf: Control, way: Linear) -> None:
        """A linear control as a state."""
        state = State(leaf.name, leaf.shape, min=leaf.min, max=leaf.max, guess=leaf.guess, scale=leaf.scale)
        rate = way.rate_control(leaf)
        self._states[leaf.name], self._rates[leaf.name] = state, rate
        self.rates.add(rate.name)
        self._exchange |= {leaf.key(): state, rate.key(): rate}

    def _put(self, expr: Expr, last: bool = False) -> Expr:
        """The same expression, restated. At the last node time is the final time."""
        clock = Time().key()
        return substitute(expr, {key: e for key, e in self._exchange.items() if not (last and key == clock)})

    def plain(self, constraints: Mapping[str, Constraint], last: bool = False) -> dict[str, Constraint]:
        """The same constraints on a node, restated."""
        if not self._exchange:
            return dict(constraints)
        return {n: type(c)(self._put(c.lhs, last), self._put(c.rhs, last)) for n, c in constraints.items()}

    def _compiled(self, dynamics: Dynamics, rows: Mapping[str, Constraint], clock: State) -> Dynamics:
        """The system restated, compiled as it was."""
        system, functions = dynamics.system, dynamics._functions
        rates: dict[State | str, Any] = {state: self._put(system.rates[state.name]) for state in system.states}
        rates |= {self._states[name]: rate for name, rate in self._rates.items()}
        kept = {rate.name for rate in self._rates.values()} | set(self._linear)
        controls = [c for c in dynamics.controls if c.name not in kept] + list(self._rates.values())
        if self._mesh.free is not None:
            low, high = self._mesh.free
            rates[clock] = 1.0
            controls.append(Control(_PACE, min=low, max=high, guess=1.0))
        constraints = {**system.constraints, **rows}
        return compile(
            System(
                rates=rates,
                outputs={name: self._put(e) for name, e in system.outputs.items()},
                constraints={n: type(c)(self._put(c.lhs), self._put(c.rhs)) for n, c in constraints.items()},
                controls=controls,
                parameters=system.parameters,
            ),
            outputs=list(functions.families["outputs"]),
            bake=dynamics.baked,
            backend=dynamics.backend,
        )

    @property
    def pace(self) -> str | None:
        """The name of the control that says how long intervals are."""
        return None if self._mesh.free is None else _PACE

    # ---- between what users see and what is solved ------------------------------------------------------------------

    def times(self, xs: Mapping[str, Any], shares: Array) -> Any:
        """The times of the nodes, given the states there and the times at their shares."""
        return shares if self.pace is None else xs[_CLOCK]

    def us(self, xs: Mapping[str, Any], held: Mapping[str, Any]) -> dict[str, Any]:
        """The controls that users see: linear ones at the nodes, the others over the intervals."""
        seen = [c.name for c in self.controls if c.name not in self._added]
        return {name: xs[name] if name in self._linear else held[name] for name in seen}

    def held(self, ts: Array, us: Mapping[str, Array], xs: Mapping[str, Array]) -> dict[str, Array]:
        """The held controls of the restated system, from what users see and all states at the nodes."""
        found = {name: values for name, values in us.items() if name not in self._linear}
        steps = np.diff(ts)
        for name, rate in self._rates.items():
            moves = np.diff(xs[name], axis=0)
            found[rate.name] = moves / steps.reshape(-1, *[1] * (moves.ndim - 1))
        if self.pace is not None:
            found[_PACE] = steps / ((ts[-1] - ts[0]) * self._mesh.widths)
        return found

    def started(
        self, xs: dict[str, Array], us: dict[str, Array], ts: Array
    ) -> tuple[dict[str, Array], dict[str, Array]]:
        """A guess made whole: states and held controls that fit its linear controls and times."""
        if self.pace is not None:
            xs = xs | {_CLOCK: ts}
        return xs, us | self.held(ts, {}, xs)

    def at_rest(self, held: dict[str, Any]) -> dict[str, Any]:
        """Held controls under which linear ones stay as they are."""
        return {name: 0.0 * values if name in self.rates else values for name, values in held.items()}


def _with_bounds(objective: Objective, linear: set[str]) -> tuple[Expr | None, list[tuple[Control, Expr]]]:
    """The running cost with a bound, a linear control of its own, in place of each norm of linear controls."""
    found = norm_controls(objective.running, objective.sign)
    bounds, back = [], {}
    for bound, operand in zip(found.controls, found.operands):
        if any(isinstance(leaf, Control) and leaf.name in linear for leaf in leaves_of(operand)):
            bounds.append((bound, operand))
        else:
            back[bound.key()] = Norm(operand)
    return None if found.running is None else substitute(found.running, back), bounds
