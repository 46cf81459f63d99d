"""The same problems in CasADi's Opti with plain IPOPT, in the style of its examples."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np

from ..harness.expected import needed
from .statement import Foreign, Phased, Points, coefficients

#: Functions are expanded into scalar expressions, which makes IPOPT several times as fast. Its other defaults stay.
_PLUGIN = {"expand": True, "print_time": False, "error_on_fail": False}
_OPTIONS = {"print_level": 0, "sb": "yes"}


@dataclasses.dataclass
class Nlp:
    """A problem in Opti and its objective, as stated: a maximum is not negated."""

    opti: Any
    cost: Any

    def prepare(self, seconds: float) -> None:
        """Make the solver, which stops after that many seconds of the processor."""
        self.opti.solver("ipopt", _PLUGIN, {**_OPTIONS, "max_cpu_time": seconds})

    def solve(self) -> tuple[bool, float, int, str]:
        """Whether it is solved, the objective, iterations, and IPOPT's word."""
        with contextlib.suppress(RuntimeError):  # raised for every failure; the status says which
            self.opti.solve_limited()
        stats = self.opti.stats()
        cost = float(self.opti.debug.value(self.cost))
        return bool(stats["success"]), cost, int(stats["iter_count"]), str(stats["return_status"])


def nlp_of(problem: Foreign | Phased) -> Nlp:
    """The problem in Opti. Raises Absent without CasADi."""
    opti = needed("casadi", "'twistax[casadi]'").Opti()
    phases = problem.phases if isinstance(problem, Phased) else [problem]
    written = [_Statement(phase, opti) for phase in phases]
    total = sum(statement.written() for statement in written)
    for before, after in itertools.pairwise(written):
        for i, (name, var) in enumerate(after.problem.states.items()):
            if var.start is None:
                opti.subject_to(after.X[i, 0] == before.X[list(before.problem.states).index(name), -1])
    opti.minimize(-total if problem.maximise else total)
    return Nlp(opti, total)


class _Statement:
    """What Opti knows while a problem, or a phase of it, is written down."""

    def __init__(self, problem: Foreign, opti: Any) -> None:
        self.ca = ca = needed("casadi", "'twistax[casadi]'")
        self.problem, self.opti = problem, opti
        count = problem.intervals
        self.X = opti.variable(len(problem.states), count + 1)
        self.U: Any = opti.variable(len(problem.controls), count + problem.linear) if problem.controls else None
        self.free = {name: opti.variable() for name in problem.free}
        self.p = ca.vertcat(*self.free.values()) if self.free else ca.DM(0, 1)
        self.T = opti.variable() if isinstance(problem.final_time, tuple) else problem.final_time
        self.f, self.sides, self.reads = self._function()

    def _function(self) -> tuple[Any, list[tuple[float, float]], list[set[str]]]:
        """(x, u, p, t) -> rates, density of the cost, path rows; limits of the rows, and the names that they read."""
        ca, problem = self.ca, self.problem
        groups = (problem.states, problem.controls, problem.free)
        x, u, p = (ca.SX.sym(name, len(group)) for name, group in zip("xup", groups, strict=True))
        t, everything = ca.SX.sym("t"), ca.vertcat(x, u, p)
        names = [name for group in groups for name in group]
        bag = SimpleNamespace(**{name: everything[i] for i, name in enumerate(names)}, t=t)
        path = problem.path(bag, ca) if problem.path else {}
        rows = [ca.SX(row) for _, row, _ in path.values()]
        running = problem.running(bag, ca) if problem.running else 0.0
        outputs = [ca.vertcat(*problem.rates(bag, ca)), running, ca.vertcat(*rows)]
        reads = [{name for name in [*names, "t"] if ca.depends_on(row, getattr(bag, name))} for row in rows]
        return ca.Function("f", [x, u, p, t], outputs), [(low, high) for low, _, high in path.values()], reads

    def written(self) -> Any:
        """Write down all rows and the guess; gives the objective."""
        problem = self.problem
        step = self._collocated if isinstance(problem.rule, Points) else self._shot
        total: Any = 0.0
        for k, width in enumerate(np.diff(problem.shares)):
            total += step(k, problem.shares[k] * self.T, width * self.T)
            self._rows_of_interval(k)
        self._rows(-1, self._u(-1), self.T, lambda reads: not self._held & reads)
        self._limits()
        self._guess()
        if problem.cost:
            total += problem.cost(self._at(self.X[:, -1], self.T), self.ca)
        return total

    def _at(self, x: Any, t: Any) -> SimpleNamespace:
        return SimpleNamespace(**{name: x[i] for i, name in enumerate(self.problem.states)}, **self.free, t=t)

    def _u(self, k: int) -> Any:
        return self.ca.DM(0, 1) if self.U is None else self.U[:, k]

    def _control(self, k: int, share: float) -> Any:
        if not self.problem.linear:
            return self._u(k)
        return (1.0 - share) * self.U[:, k] + share * self.U[:, k + 1]

    # ---- an interval; each gives its share of the running cost ------------------------------------------------------

    def _shot(self, k: int, t: Any, h: Any) -> Any:
        steps = self.problem.rule.substeps
        f = lambda x, share: self.f(x, self._control(k, share), self.p, t + share * h)  # noqa: E731
        x, d, cost = self.X[:, k], h / steps, 0.0
        for i in range(steps):
            begin, middle, end = i / steps, (i + 0.5) / steps, (i + 1) / steps
            k1, q1, _ = f(x, begin)
            k2, q2, _ = f(x + d / 2 * k1, middle)
            k3, q3, _ = f(x + d / 2 * k2, middle)
            k4, q4, _ = f(x + d * k3, end)
            x = x + d / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            cost += d / 6 * (q1 + 2 * q2 + 2 * q3 + q4)
            if i + 1 < steps:
                self._boxes(x)
                self._asked(f(x, end)[2], lambda reads: reads & set(self.problem.states))
        self.opti.subject_to(self.X[:, k + 1] == x)
        return cost

    def _collocated(self, k: int, t: Any, h: Any) -> Any:
        """Direct collocation, whose inner states are unknowns."""
        ca, rule, shares = self.ca, self.problem.rule, self.problem.shares
        points = ca.collocation_points(rule.points, rule.kind)
        slopes, ends, _ = ca.collocation_coeff(points)
        weights = coefficients(rule.kind, rule.points)[1]  # CasADi's for one Radau point give the start half of it
        inner = self.opti.variable(len(self.problem.states), len(points))
        places = shares[k] + (shares[k + 1] - shares[k]) * np.array(points)
        for i, var in enumerate(self.problem.states.values()):
            self.opti.set_initial(inner[i, :], np.interp(places, shares, var.guessed(shares))[None])
        all_states, cost = ca.horzcat(self.X[:, k], inner), 0.0
        moved = all_states @ slopes
        for i, c in enumerate(points):
            rate, density, _ = self.f(inner[:, i], self._control(k, c), self.p, t + c * h)
            self.opti.subject_to(moved[:, i] == h * rate)
            cost += weights[i] * density
        self.opti.subject_to(self.X[:, k + 1] == all_states @ ends)
        return h * cost

    # ---- limits -----------------------------------------------------------------------------------------------------

    @property
    def _held(self) -> set[str]:
        """Names of the controls that are held over intervals."""
        return set() if self.problem.linear else set(self.problem.controls)

    def _asked(self, rows: Any, which: Callable[[set[str]], Any]) -> None:
        """Path rows, those of which a function of the names that they read says so."""
        for i, ((low, high), reads) in enumerate(zip(self.sides, self.reads, strict=True)):
            if which(reads):
                self._between(low, rows[i], high)

    def _rows(self, k: int, u: Any, t: Any, which: Callable[[set[str]], Any]) -> None:
        if self.sides:
            self._asked(self.f(self.X[:, k], u, self.p, t)[2], which)

    def _rows_of_interval(self, k: int) -> None:
        """Path rows at its first node, and at its second those that read a held control."""
        problem = self.problem
        leaves = {**problem.states, **problem.controls}
        fixed = {name for name, var in leaves.items() if var.start is not None and name not in self._held} | {"t"}
        self._rows(k, self._u(k), problem.shares[k] * self.T, lambda reads: k or not reads <= fixed)
        after = lambda reads: reads & self._held and reads & set(problem.states)  # noqa: E731
        self._rows(k + 1, self._u(k), problem.shares[k + 1] * self.T, after)

    def _boxes(self, x: Any) -> None:
        for i, var in enumerate(self.problem.states.values()):
            self._between(var.low, x[i], var.high)

    def _between(self, low: float, expr: Any, high: float) -> None:
        if low == high:
            self.opti.subject_to(expr == low)
        elif low > -math.inf or high < math.inf:
            self.opti.subject_to(self.opti.bounded(low, expr, high))

    def _limits(self) -> None:
        """Boxes, where no value is fixed, and ends."""
        problem, ca = self.problem, self.ca
        for values, group in ((self.X, problem.states), (self.U, problem.controls)):
            for i, var in enumerate(group.values()):
                row = values[i, :]
                if var.start is not None:
                    self.opti.subject_to(row[0] == var.start)
                if var.end is not None:
                    self.opti.subject_to(row[-1] == var.end)
                if var.limited:
                    open_part = row[var.start is not None : row.shape[1] - (var.end is not None)]
                    self.opti.subject_to(self.opti.bounded(var.low, open_part, var.high))
        for name, var in problem.free.items():
            self._between(var.low, self.free[name], var.high)
        if isinstance(problem.final_time, tuple):
            self._between(problem.final_time[0], self.T, problem.final_time[1])
        if problem.ends:
            last = self._at(self.X[:, -1], self.T)
            for row in problem.ends(last, ca, self._at(self.X[:, 0], 0.0)):
                self.opti.subject_to(row == 0)

    def _guess(self) -> None:
        problem = self.problem
        for values, group in ((self.X, problem.states), (self.U, problem.controls)):
            for i, (name, var) in enumerate(group.items()):
                self.opti.set_initial(values[i, :], var.guessed(problem.places(name))[None])
        for name, var in problem.free.items():
            self.opti.set_initial(self.free[name], var.guess)
        if isinstance(problem.final_time, tuple):
            self.opti.set_initial(self.T, problem.final_time[2])
