"""A statement with continuous controls and free node times, restated with held controls and nodes at given shares.

A linear control becomes a state with a held rate, a spline a chain of states with a held last derivative. With free
node times, interval k is s_k times as long as its share of the final time says: a held control, the pace s, multiplies
all rates and the running cost, and time becomes a state with rate 1, which ends at the final time. So all of them keep
the problem in stages.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from numpy import ndarray as Array

from ..expr import Constraint, Control, Expr, Parameter, State, Time, leaves_of
from ..expr.graph import substitute
from ..integrators import FirstOrderHold, PiecewisePolynomial, ZeroOrderHold
from ..system import System
from ..system.dynamics import Dynamics, compile
from .cones import continuous_bound, is_mixed, norm_controls
from .controls import Linear, Spline, continuous_controls, rates_among
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
        rates: name of a held derivative of a continuous control -> of which order it is.
        at_end: constraints on the last node that come with free node times.
        bounds: name of a continuous bound that was added -> the size of controls that it bounds.
        at_join: state -> what it begins as after another phase, of the end of that.

    Raises:
        ModelError: see `continuous_controls`.
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
        ways = continuous_controls(controls, dynamics.controls)
        rates = rates_among(dynamics.controls)
        self.controls = [c for c in dynamics.controls if c.name not in rates]
        self._added = frozenset(added)
        self._mesh, self._smooth = mesh, {c.name: c for c in self.controls if c.name in ways}
        self.dynamics, self.objective = dynamics, objective
        self.at_end: dict[str, Constraint] = {}
        self.at_join: dict[str, Expr] = {}
        #: Of every continuous control itself and its derivatives, the last one held.
        self._chains: dict[str, tuple[list[State], Control]] = {}
        self.rates: dict[str, int] = {}
        self.bounds: dict[str, Expr] = {}
        self._exchange: dict[str, Expr] = {}
        rows: dict[str, Constraint] = {}
        if ways:
            running, bounds = _with_bounds(objective, set(ways))
            self._smooth |= {s.name: s for s, _ in bounds}
            rows = {s.name: continuous_bound(size, s) <= 0.0 for s, size in bounds}
            self.bounds = {s.name: size for s, size in bounds}
            self.objective = type(objective)(objective.final, running=running)
            for name, leaf in self._smooth.items():
                self._add(leaf, ways.get(name, Linear()))
        clock = State(_CLOCK, initial=0.0 if first else None)
        if mesh.free is not None:
            self._exchange[Time().key()] = clock
            self.at_end = {"the last node is at the final time": clock == Time()}
            self.at_join = {_CLOCK: Time()}
        self.straight = {name for name, (states, _) in self._chains.items() if len(states) == 1}
        #: States that the system as stated does not have.
        self.hidden = {s.name for states, _ in self._chains.values() for s in states}
        self.hidden |= {_CLOCK} if mesh.free is not None else set()
        if self._chains or mesh.free is not None:
            final, running = self.objective.final, self.objective.running
            self.objective = type(objective)(
                None if final is None else self.put(final, last=True),
                running=None if running is None else self.put(running),
            )
            self.dynamics = self._compiled(dynamics, rows, clock)

    def _add(self, leaf: Control, way: Spline) -> None:
        """A continuous control as states."""
        states, held = self._chains[leaf.name] = way.leaves(leaf)
        self.rates[held.name] = len(states)
        self._exchange |= {leaf.key(): states[0], held.key(): held}
        self._exchange |= {Control(s.name, s.shape).key(): s for s in states[1:]}

    def put(self, expr: Expr, last: bool = False) -> Expr:
        """The same expression, restated. At the last node time is the final time."""
        clock = Time().key()
        return substitute(expr, {key: e for key, e in self._exchange.items() if not (last and key == clock)})

    def plain(self, constraints: Mapping[str, Constraint], last: bool = False) -> dict[str, Constraint]:
        """The same constraints on a node, restated."""
        if not self._exchange:
            return dict(constraints)
        return {n: type(c)(self.put(c.lhs, last), self.put(c.rhs, last)) for n, c in constraints.items()}

    def _compiled(self, dynamics: Dynamics, rows: Mapping[str, Constraint], clock: State) -> Dynamics:
        """The system restated, compiled as it was."""
        system, functions = dynamics.system, dynamics._functions
        rates: dict[State | str, Any] = {state: self.put(system.rates[state.name]) for state in system.states}
        for states, held in self._chains.values():
            rates |= zip(states, [*states[1:], held])
        kept = set(self.rates) | self.hidden
        controls = [c for c in dynamics.controls if c.name not in kept] + [held for _, held in self._chains.values()]
        if self._mesh.free is not None:
            low, high = self._mesh.free
            rates[clock] = 1.0
            controls.append(Control(_PACE, min=low, max=high, guess=1.0))
        constraints = {**system.constraints, **rows}
        known = {leaf.name for leaf in system.parameters}
        read = [leaf for row in rows.values() for leaf in leaves_of(row) if isinstance(leaf, Parameter)]
        new = {leaf.name: leaf for leaf in read if leaf.name not in known}
        return compile(
            System(
                rates=rates,
                outputs={name: self.put(e) for name, e in system.outputs.items()},
                constraints={n: type(c)(self.put(c.lhs), self.put(c.rhs)) for n, c in constraints.items()},
                controls=controls,
                parameters=(*system.parameters, *new.values()),
            ),
            outputs=list(functions.families["outputs"]),
            bake=dynamics.baked,
            backend=dynamics.backend,
        )

    @property
    def smooth(self) -> Collection[str]:
        """The names of the continuous controls, and of continuous bounds on their sizes."""
        return self._smooth.keys()

    @property
    def derivatives(self) -> dict[str, str]:
        """Name of a held derivative of a continuous control -> what it is, in the language."""
        return {
            held.name: f"{'Rate(' * len(states)}{name}{')' * len(states)}"
            for name, (states, held) in self._chains.items()
        }

    @property
    def pace(self) -> str | None:
        """The name of the control that says how long intervals are."""
        return None if self._mesh.free is None else _PACE

    # ---- between what users see and what is solved ------------------------------------------------------------------

    def times(self, xs: Mapping[str, Any], shares: Array) -> Any:
        """The times of the nodes, given the states there and the times at their shares."""
        return shares if self.pace is None else xs[_CLOCK]

    def us(self, xs: Mapping[str, Any], held: Mapping[str, Any]) -> dict[str, Any]:
        """The controls that users see: continuous ones at the nodes, the others over the intervals."""
        seen = [c.name for c in self.controls if c.name not in self._added]
        return {name: xs[name] if name in self._smooth else held[name] for name in seen}

    def held(self, ts: Array, us: Mapping[str, Array], xs: Mapping[str, Array]) -> dict[str, Array]:
        """The held controls of the restated system, from what users see and all states at the nodes."""
        found = {name: values for name, values in us.items() if name not in self._smooth}
        steps = np.diff(ts)
        for states, held in self._chains.values():
            moves = np.diff(xs[states[-1].name], axis=0)
            found[held.name] = moves / steps.reshape(-1, *[1] * (moves.ndim - 1))
        if self.pace is not None:
            found[_PACE] = steps / ((ts[-1] - ts[0]) * self._mesh.widths)
        return found

    def over_time(self, ts: Array, us: Mapping[str, Array], xs: Mapping[str, Array]) -> dict[str, Any]:
        """The controls that users see as tables over time, from them and all states at the nodes."""
        found: dict[str, Any] = {}
        held = self.held(ts, us, xs)
        for name, values in us.items():
            states, last = self._chains.get(name, ([], None))
            if last is None:
                found[name] = ZeroOrderHold(ts[:-1], values)
            elif len(states) == 1:
                found[name] = FirstOrderHold(ts, values)
            else:
                rows = [values[:-1], *(xs[s.name][:-1] for s in states[1:]), held[last.name]]
                found[name] = PiecewisePolynomial(ts[:-1], np.stack(rows, axis=1))
        return found

    def started(
        self, xs: dict[str, Array], us: dict[str, Array], ts: Array
    ) -> tuple[dict[str, Array], dict[str, Array]]:
        """A guess made whole: states and held controls that fit its continuous controls and times."""
        if self.pace is not None:
            xs = xs | {_CLOCK: ts}
        return xs, us | self.held(ts, {}, xs)

    def at_rest(self, held: dict[str, Any]) -> dict[str, Any]:
        """Held controls under which linear ones stay as they are, and splines go on as their derivatives say."""
        return {name: 0.0 * values if name in self.rates else values for name, values in held.items()}


def _with_bounds(objective: Objective, smooth: set[str]) -> tuple[Expr | None, list[tuple[Control, Expr]]]:
    """The running cost with a bound, a linear control of its own, in place of each size of continuous controls."""
    found = norm_controls(objective.running, objective.sign)
    bounds, back = [], {}
    for bound, size in zip(found.controls, found.sizes):
        is_smooth = any(isinstance(leaf, Control) and leaf.name in smooth for leaf in leaves_of(size))
        if is_smooth and not is_mixed(size, smooth):
            bounds.append((bound, size))
        else:
            back[bound.key()] = size
    return None if found.running is None else substitute(found.running, back), bounds
