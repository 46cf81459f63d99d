"""A published trajectory problem as data for both solvers: formulas, mesh and guess."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Mapping, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy import ndarray as Array

import twistax as tx

from ...trajectory import Collocation, Held, Initial, Linear, MultipleShooting, Phase, Problem

#: Functions under the names that CasADi has for them.
MATHS = SimpleNamespace(sin=tx.Sin, cos=tx.Cos, tan=tx.Tan, exp=tx.Exp, sqrt=tx.Sqrt, log=tx.Log, tanh=tx.Tanh)


@dataclasses.dataclass(frozen=True)
class Var:
    """A scalar state or control: its limits, its values at both ends where they are fixed, and its guess.

    A guess is a number, or an array function of the share of the final time, 0 to 1. None is the straight line between
    the end values; where one of these is free, the other one everywhere.
    """

    low: float = -math.inf
    high: float = math.inf
    start: float | None = None
    end: float | None = None
    guess: Any = None

    @property
    def limited(self) -> bool:
        """Whether it has a limit."""
        return self.low > -math.inf or self.high < math.inf

    def guessed(self, shares: Array) -> Array:
        """The guess at these fractions of the final time."""
        if callable(self.guess):
            return np.broadcast_to(np.asarray(self.guess(shares), float), shares.shape)
        if self.guess is not None:
            return np.full(shares.shape, float(self.guess))
        ends = [value for value in (self.start, self.end) if value is not None] or [0.0]
        return ends[0] + shares * (ends[-1] - ends[0])


@dataclasses.dataclass(frozen=True)
class RungeKutta:
    """Multiple shooting by RK4, which integrates the running cost too."""

    substeps: int = 1

    @property
    def words(self) -> str:
        """For tables."""
        return f"RK4 x {self.substeps}"

    @property
    def transcription(self) -> Any:
        """Ours."""
        return MultipleShooting(substeps=self.substeps)


@dataclasses.dataclass(frozen=True)
class Points:
    """Collocation, the running cost by its weights. Ours solves its equations inside of an interval."""

    points: int
    kind: str = "legendre"  # or "radau", as CasADi calls them

    @property
    def words(self) -> str:
        """For tables."""
        if self.points == 1:
            return "implicit midpoint" if self.kind == "legendre" else "backward Euler"
        return f"{self.kind.capitalize()} {self.points}"

    @property
    def transcription(self) -> Any:
        """Ours."""
        a, b, c = coefficients(self.kind, self.points)
        order = 2 * self.points - (self.kind == "radau")
        return Collocation(tx.tableaus.CollocationTableau(self.words, order, a, b, c))


def coefficients(kind: str, points: int) -> tuple[Array, Array, Array]:
    """a, b and c of collocation at the Gauss or Radau points, which are roots of Legendre polynomials."""
    last = np.polynomial.legendre.Legendre.basis(points)
    if kind == "radau":
        last = last - np.polynomial.legendre.Legendre.basis(points - 1)
    c = 0.5 * (np.sort(last.roots().real) + 1.0)
    if kind == "radau":
        c[-1] = 1.0
    powers = np.arange(1, points + 1)
    basis = np.linalg.inv(np.vander(c, points, increasing=True))  # columns: polynomials that are 1 at one point
    return (c[:, None] ** powers / powers) @ basis, (1.0 / powers) @ basis, c


@dataclasses.dataclass(frozen=True)
class Foreign:
    """A problem of others, in scalar states and controls.

    Functions take the bag of values by name, with the time as `t`, and the functions of CasADi or of `MATHS`.

    Args:
        source: of the statement, with equation, page or file.
        rates: of the states, in order.
        final_time: a number, or (low, high, guess).
        running, cost: what is integrated, and what is read at the end; their sum is minimised, or maximised.
        path: name -> (low, expression, high), asked at the nodes, with held controls at both ends of each interval.
        ends: expressions that vanish at the last node; a second bag has the states of the first node.
        published: the optimum in print, on whatever mesh.
        linear: whether controls are linear between nodes, or else held.
        rule: how an interval is integrated; `theirs` says what the source does where that is something else.
        nodes: fractions of the final time instead of equal intervals.
    """

    name: str
    source: str
    states: Mapping[str, Var]
    controls: Mapping[str, Var]
    rates: Callable[[Any, Any], Sequence[Any]]
    final_time: Any
    intervals: int
    rule: Any = RungeKutta()
    linear: bool = False
    running: Callable[[Any, Any], Any] | None = None
    cost: Callable[[Any, Any], Any] | None = None
    maximise: bool = False
    path: Callable[[Any, Any], Mapping[str, tuple[float, Any, float]]] | None = None
    ends: Callable[[Any, Any, Any], Sequence[Any]] | None = None
    free: Mapping[str, Var] = dataclasses.field(default_factory=dict)
    nodes: Any = None
    published: float | None = None
    theirs: str = ""

    @functools.cached_property
    def shares(self) -> Array:
        """Of the final time, at the nodes."""
        return np.linspace(0.0, 1.0, self.intervals + 1) if self.nodes is None else np.asarray(self.nodes)

    @property
    def transcription(self) -> str:
        """In a few words."""
        return f"{self.rule.words}, {'linear' if self.linear else 'held'}, {self.intervals}"

    def places(self, name: str) -> Array:
        """Shares of the final time where the guess of a state or control is read."""
        return self.shares if self.linear or name in self.states else self.shares[:-1]

    def twistax(self) -> Any:
        """The problem as users of this package state it."""
        dynamics, objective, options = self.stated()
        free = {tx.Parameter(name): (_side(var.low), _side(var.high)) for name, var in self.free.items()}
        return Problem(dynamics, objective, free=free or None, **options)

    def stated(self) -> tuple[Any, Any, dict[str, Any]]:
        """The compiled system, the objective or None, and what a problem and a phase take besides."""
        states = {name: tx.State(name, min=_side(var.low), max=_side(var.high)) for name, var in self.states.items()}
        controls = {n: tx.Control(n, min=_side(var.low), max=_side(var.high)) for n, var in self.controls.items()}
        free = {name: tx.Parameter(name, value=float(var.guess)) for name, var in self.free.items()}
        leaves: dict[str, Any] = {**states, **controls, **free}
        bag = SimpleNamespace(**leaves, t=tx.Time())
        constraints: dict[str, Any] = {}
        for name, (low, expr, high) in (self.path(bag, MATHS) if self.path else {}).items():
            constraints |= _sides(name, low, tx.to_expr(expr), high)
        rates: dict[Any, Any] = dict(zip(states.values(), self.rates(bag, MATHS), strict=True))
        system = tx.System(rates=rates, controls=list(controls.values()), constraints=constraints)
        running, cost = (part and part(bag, MATHS) for part in (self.running, self.cost))
        best = tx.Maximize if self.maximise else tx.Minimize
        unknowns = {**self.states, **self.controls}
        final: list[Any] = [{states[name]: var.end for name, var in self.states.items() if var.end is not None}]
        final += [controls[name] == var.end for name, var in self.controls.items() if var.end is not None]
        if self.ends:
            first = SimpleNamespace(**{name: Initial(leaf) for name, leaf in states.items()})
            final += [tx.to_expr(row) == 0.0 for row in self.ends(bag, MATHS, first)]
        times: dict[str, Any] = {"final_time": self.final_time}
        if isinstance(self.final_time, tuple):
            times = {"final_time": self.final_time[:2], "final_time_guess": self.final_time[2]}
        options = times | {
            "nodes": self.intervals + 1 if self.nodes is None else list(self.shares),
            "initial": {leaves[name]: var.start for name, var in unknowns.items() if var.start is not None},
            "final": final,
            "controls": Linear() if self.linear else Held(),
            "guess": {leaves[name]: var.guessed(self.places(name)) for name, var in unknowns.items()}
            | {free[name]: float(var.guess) for name, var in self.free.items()},
            "transcription": self.rule.transcription,
        }
        objective = best(cost, running=running) if self.running or self.cost else None
        return tx.compile(system), objective, options


@dataclasses.dataclass(frozen=True)
class Phased:
    """A problem of others in phases, one after another.

    A state without a value at the start of a later phase goes on from the phase before. Objectives are added; all of
    them are minimised, or all maximised. Times are those since the beginning of a phase.
    """

    name: str
    source: str
    phases: Sequence[Foreign]
    published: float | None = None
    theirs: str = ""

    @property
    def maximise(self) -> bool:
        """Whether more is better."""
        return any(phase.maximise for phase in self.phases)

    @property
    def transcription(self) -> str:
        """In a few words."""
        return f"{self.phases[0].transcription} in {len(self.phases)} phases"

    def twistax(self) -> Any:
        """The problem as users of this package state it."""
        statements = [(phase.name, *phase.stated()) for phase in self.phases]
        return Problem([Phase(system, best, name=name, **options) for name, system, best, options in statements])


def _side(limit: float) -> float | None:
    return limit if math.isfinite(limit) else None


def _sides(name: str, low: float, expr: Any, high: float) -> dict[str, Any]:
    """An equality, or an inequality for each side that has a limit."""
    if low == high:
        return {name: expr == low}
    sides = {f"{name}, low": expr >= low} if low > -math.inf else {}
    return sides | ({f"{name}, high": expr <= high} if high < math.inf else {})
