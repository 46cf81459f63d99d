"""The bridge for continuous controls and free node times. The result has piecewise constant controls and fixed nodes.

A linear control becomes a state with a piecewise constant rate. A spline becomes a chain of integrators, whose last
derivative is piecewise constant. With free node times, the length of interval k is s_k times its fraction of the final
time: an additional piecewise constant control s multiplies all rates and the running cost. Time becomes a
state, which ends at the final time. The problem keeps its stage structure.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from numpy import ndarray as Array

from ....expr import Constraint, Control, Expr, State, Time, leaves_of
from ....expr.graph import substitute
from ....integrators import FirstOrderHold, PiecewisePolynomial, ZeroOrderHold
from ....system.dynamics import Dynamics
from ...transcription.mesh import Mesh
from ..controls import Linear, Spline, continuous_controls, rates_among
from ..statement import Objective
from ..terms import bound_row, is_mixed, sizes_in
from .bridge import Bridge, Path, Statement, extended

#: Names of the variables that free node times add.
_CLOCK, _PACE = "time of the node", "pace of the interval"


class ContinuousControls(Bridge):
    """A problem with piecewise constant controls and nodes at fixed fractions of the final time.

    Args:
        statement: the problem with continuous controls.
        mesh: the mesh; its intervals may have free lengths.
        first: whether the path starts in this phase, and does not continue another one.

    Attributes:
        controls: the controls of the original system, without rates.
        straight: names of the states that are linear over each interval.
        rates: name of a piecewise constant derivative of a continuous control -> the order of that derivative.
        bounds: name of an additional continuous bound -> the norm of controls that it bounds.
        at_join: state -> its initial value after another phase, as an expression of the end of that phase.
        pace: the name of the control that scales interval lengths; None for fixed node times.

    Raises:
        ModelError: see `continuous_controls`.
    """

    def __init__(self, statement: Statement, mesh: Mesh, first: bool) -> None:
        dynamics, continuous = statement.dynamics, continuous_controls(statement.controls, statement.dynamics.controls)
        rates = rates_among(dynamics.controls)
        self.controls = [c for c in dynamics.controls if c.name not in rates]
        self._mesh, self._smooth = mesh, {c.name: c for c in self.controls if c.name in continuous}
        self.pace = None if mesh.free is None else _PACE
        self.at_join: dict[str, Expr] = {_CLOCK: Time()} if self.pace else {}
        #: For each continuous control: the control and its derivatives. The last derivative is piecewise constant.
        self._chains: dict[str, tuple[list[State], Control]] = {}
        self.rates: dict[str, int] = {}
        self.bounds: dict[str, Expr] = {}
        self._exchange: dict[str, Expr] = {}
        rows: dict[str, Constraint] = {}
        if continuous:
            running, bounds = _with_bounds(statement.objective, set(continuous))
            self._smooth |= {s.name: s for s, _ in bounds}
            rows = {s.name: bound_row(size, s) <= 0.0 for s, size in bounds}
            self.bounds = {s.name: size for s, size in bounds}
            objective = type(statement.objective)(statement.objective.final, running=running)
            statement = dataclasses.replace(statement, objective=objective)
            for name, leaf in self._smooth.items():
                self._add(leaf, continuous.get(name, Linear()))
        clock = State(_CLOCK, initial=0.0 if first else None)
        if self.pace:
            self._exchange[Time().key()] = clock
        self.straight = {name for name, (states, _) in self._chains.items() if len(states) == 1}
        #: Additional states of the reformulated system.
        self.hidden = {s.name for states, _ in self._chains.values() for s in states}
        self.hidden |= {_CLOCK} if self.pace else set()
        if self._exchange:
            statement = statement.substituted(self.put)
            statement = dataclasses.replace(statement, dynamics=self._compiled(dynamics, rows, clock))
        if self.pace:
            at_end = {**statement.rows[statement.last], "the last node is at the final time": clock == Time()}
            statement = dataclasses.replace(statement, rows={**statement.rows, statement.last: at_end})
        self.statement = statement

    def _add(self, leaf: Control, spline: Spline) -> None:
        """Replace a continuous control by a chain of integrators with a piecewise constant last derivative."""
        states, last = self._chains[leaf.name] = spline.leaves(leaf)
        self.rates[last.name] = len(states)
        self._exchange |= {leaf.key(): states[0], last.key(): last}
        self._exchange |= {Control(s.name, s.shape).key(): s for s in states[1:]}

    def put(self, expr: Expr, last: bool = False) -> Expr:
        """An expression with states for continuous controls and, before the last node, for time."""
        clock = Time().key()
        return substitute(expr, {key: e for key, e in self._exchange.items() if not (last and key == clock)})

    def _compiled(self, dynamics: Dynamics, rows: Mapping[str, Constraint], clock: State) -> Dynamics:
        """The system with continuous controls as states, and with time as a state if node times are free."""
        rates: dict[State, Any] = {}
        for states, last in self._chains.values():
            rates |= zip(states, [*states[1:], last])
        controls = [last for _, last in self._chains.values()]
        if self._mesh.free is not None:
            low, high = self._mesh.free
            rates[clock] = 1.0
            controls.append(Control(_PACE, min=low, max=high, guess=1.0))
        return extended(dynamics, rates, rows, self.put, controls, dropped=self.rates.keys() | self.hidden)

    @property
    def smooth(self) -> Collection[str]:
        """The names of the continuous controls, and of continuous bounds on their norms."""
        return self._smooth.keys()

    @property
    def derivatives(self) -> dict[str, str]:
        """Name of the piecewise constant derivative of a continuous control -> the expression by
        which users write it.
        """
        return {
            last.name: f"{'Rate(' * len(states)}{name}{')' * len(states)}"
            for name, (states, last) in self._chains.items()
        }

    # ---- between what users see and what is solved ------------------------------------------------------------------

    def times(self, xs: Mapping[str, Any], shares: Array) -> Any:
        """The node times, from the states at the nodes and the node times of a fixed mesh."""
        return shares if self.pace is None else xs[_CLOCK]

    def back(self, xs: dict[str, Any], us: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
        seen = {name: values for name, values in xs.items() if name not in self.hidden}
        return seen, {c.name: xs[c.name] if c.name in self._smooth else us[c.name] for c in self.controls}

    def held(self, ts: Array, us: Mapping[str, Array], xs: Mapping[str, Array]) -> dict[str, Array]:
        """The piecewise constant controls of the reformulated system, from the controls and states of a trajectory."""
        controls = {name: values for name, values in us.items() if name not in self._smooth}
        steps = np.diff(ts)
        for states, last in self._chains.values():
            changes = np.diff(xs[states[-1].name], axis=0)
            controls[last.name] = changes / steps.reshape(-1, *[1] * (changes.ndim - 1))
        if self.pace is not None:
            controls[_PACE] = steps / ((ts[-1] - ts[0]) * self._mesh.widths)
        return controls

    def over_time(self, ts: Array, us: Mapping[str, Array], xs: Mapping[str, Array]) -> dict[str, Any]:
        """The controls of a trajectory as functions of time."""
        tables: dict[str, Any] = {}
        derivatives = self.held(ts, us, xs)
        for name, values in us.items():
            states, last = self._chains.get(name, ([], None))
            if last is None:
                tables[name] = ZeroOrderHold(ts[:-1], values)
            elif len(states) == 1:
                tables[name] = FirstOrderHold(ts, values)
            else:
                rows = [values[:-1], *(xs[s.name][:-1] for s in states[1:]), derivatives[last.name]]
                tables[name] = PiecewisePolynomial(ts[:-1], np.stack(rows, axis=1))
        return tables

    def complete(self, guess: Path) -> None:
        guess.add_bounds(self.bounds)
        if self.pace is not None:
            guess.xs[_CLOCK] = guess.ts
        guess.us |= self.held(guess.ts, {}, guess.xs)

    def forward(self, path: Path) -> None:
        path.xs |= {name: values for name, values in path.us.items() if name in self._smooth}
        path.us = self.held(path.ts, path.us, path.xs)

    def at_rest(self, controls: dict[str, Any]) -> dict[str, Any]:
        """The controls with zeros for the piecewise constant derivatives of linear controls and splines."""
        return {name: 0.0 * values if name in self.rates else values for name, values in controls.items()}


def _with_bounds(objective: Objective, smooth: set[str]) -> tuple[Expr | None, list[tuple[Control, Expr]]]:
    """The running cost with a linear control as the bound of each norm of continuous controls, and the norms that these
    bound.
    """
    running, controls, sizes = sizes_in(objective.running, objective.sign)
    bounds, back = [], {}
    for bound, size in zip(controls, sizes):
        is_smooth = any(isinstance(leaf, Control) and leaf.name in smooth for leaf in leaves_of(size))
        if is_smooth and not is_mixed(size, smooth):
            bounds.append((bound, size))
        else:
            back[bound.key()] = size
    return None if running is None else substitute(running, back), bounds
