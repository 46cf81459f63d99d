"""Problems in stages written with CasADi: for the core, and as one problem for IPOPT."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca
import numpy as np
from numpy import ndarray as Array
from python_functions import PythonFunctions

from twistax.solver import CoreSolution, Options, Stages, Units, solve

#: With these the core takes the choices of IPOPT, and so the same steps.
AS_IPOPT = {"multiplier_start": 1.0, "slack_push": 1e-2, "objective_gradient": 100.0}

Rows = Callable[[Any, Any, Any], Sequence[Any]]


@dataclasses.dataclass
class Stage:
    """One stage; functions take x, u, p."""

    states: int
    controls: int = 0
    cost: Callable[[Any, Any, Any], Any] = lambda x, u, p: 0
    after: Rows = lambda x, u, p: []
    inequalities: Rows = lambda x, u, p: []
    equalities: Rows = lambda x, u, p: []
    states_within: tuple[Any, Any] = (-np.inf, np.inf)
    controls_within: tuple[Any, Any] = (-np.inf, np.inf)


def limits_of(stage: Stage, side: int) -> Array:
    return np.concatenate(
        [
            np.broadcast_to(np.asarray(stage.states_within[side], float), stage.states),
            np.broadcast_to(np.asarray(stage.controls_within[side], float), stage.controls),
        ]
    )


def _flat(a: Any) -> Array:
    return ca.DM(a).full().ravel()


class Staged:
    """A problem of such stages, and parameters within limits."""

    def __init__(self, stages: Sequence[Stage], parameters_within: Sequence[tuple[float, float]] = ()) -> None:
        self.count = len(parameters_within)
        self._functions = [self._symbolic(stage) for stage in stages]
        rows = [[f.numel_out(i) for f, _, _ in self._functions] for i in (2, 3)]
        self.stages = Stages([s.states for s in stages], [s.controls for s in stages], *rows, self.count)
        sides = [[p[side] for p in parameters_within] for side in (0, 1)]
        self.lower, self.upper = (
            np.concatenate([*(limits_of(s, side) for s in stages), sides[side]]) for side in (0, 1)
        )

    def _symbolic(self, stage: Stage) -> tuple[Any, Any, Any]:
        x, u, p = (ca.SX.sym(n, k) for n, k in (("x", stage.states), ("u", stage.controls), ("p", self.count)))
        parts = [ca.SX(stage.cost(x, u, p))]
        parts += [ca.vertcat(ca.SX(0, 1), *f(x, u, p)) for f in (stage.after, stage.inequalities, stage.equalities)]
        z, weight = ca.vertcat(x, u, p), ca.SX.sym("w")
        multipliers = [ca.SX.sym("m", a.shape[0]) for a in parts[1:]]
        lagrangian = weight * parts[0] + sum(ca.dot(m, a) for m, a in zip(multipliers, parts[1:]))
        slopes = [ca.densify(ca.gradient(parts[0], z)), *(ca.densify(ca.jacobian(a, z)) for a in parts[1:])]
        return (
            ca.Function("values", [x, u, p], parts),
            ca.Function("slopes", [x, u, p], slopes),
            ca.Function("bends", [x, u, p, weight, *multipliers], [ca.densify(ca.hessian(lagrangian, z)[0])]),
        )

    def _split(self, z: Any) -> list[tuple[Any, Any, Any]]:
        found, at = [], 0
        p = z[self.stages.variables - self.count :]
        for x, u in zip(self.stages.states, self.stages.controls):
            found.append((z[at : at + x], z[at + x : at + x + u], p))
            at += x + u
        return found

    def values(self, z: Any) -> tuple[Any, list[Any], list[Any], list[Any]]:
        parts = self._split(z)
        found = [f(*part) for (f, _, _), part in zip(self._functions, parts)]
        defects = [own[1] - after[0] for own, after in zip(found, parts[1:])]
        return sum(own[0] for own in found), defects, [own[2] for own in found], [own[3] for own in found]

    def _numbers(self, z: Array) -> Any:
        cost, *blocks = self.values(z)
        return float(cost), *(np.concatenate([np.zeros(0), *map(_flat, block)]) for block in blocks)

    def _slopes(self, z: Array) -> Any:
        found = [[a.full() for a in f(*part)] for (_, f, _), part in zip(self._functions, self._split(z))]
        inner = [own[0].ravel()[: own[0].size - self.count] for own in found]
        shared = sum(own[0].ravel()[own[0].size - self.count :] for own in found)
        return np.concatenate([*inner, shared]), *([own[i] for own in found] for i in (1, 2, 3))

    def _bends(self, z: Array, weight: float, lam: Array, y: Array, ye: Array) -> Any:
        sizes = (self.stages.after, self.stages.inequalities, self.stages.equalities)
        split = [np.split(a, np.cumsum(s)[:-1]) for a, s in zip((lam, y, ye), sizes)]
        parts = zip(self._functions, self._split(z), *split)
        return [f(*part, weight, *multipliers).full() for (_, _, f), part, *multipliers in parts]

    def solve(
        self, start: Array, stop: Any = None, size: Any = None, warm: Any = None, cost: float = 1.0, **options: float
    ) -> CoreSolution:
        functions = PythonFunctions(self.stages, self._numbers, self._slopes, self._bends, stop=stop)
        return solve(
            *(self.stages, functions.functions, self.lower, self.upper, start),
            units=Units(size=size, cost=cost),
            warm=warm,
            options=Options(**options),
        )

    def by_ipopt(self, start: Array, tolerance: float = 1e-8) -> tuple[Array, float, int]:
        """The point, the cost and the iterations of IPOPT, with its own choices."""
        v = ca.SX.sym("v", self.stages.variables)
        cost, defects, h, e = self.values(v)
        sizes = [sum(self.stages.after), sum(self.stages.inequalities), sum(self.stages.equalities)]
        quiet = {"ipopt.print_level": 0, "print_time": 0, "ipopt.sb": "yes", "ipopt.tol": tolerance}
        solver = ca.nlpsol("solver", "ipopt", {"x": v, "f": cost, "g": ca.vertcat(*defects, *h, *e)}, quiet)
        low = np.concatenate([np.zeros(sizes[0]), np.full(sizes[1], -np.inf), np.zeros(sizes[2])])
        found = solver(x0=start, lbx=self.lower, ubx=self.upper, lbg=low, ubg=np.zeros(sum(sizes)))
        return _flat(found["x"]), float(found["f"]), solver.stats()["iter_count"]


def refusing(problem: Staged, first: int, last: int) -> list[int]:
    """Values are not finite from one call to another, of which the second is the first trial; counts the calls."""
    values, calls = problem._numbers, [0]

    def numbers(z: Array) -> Any:
        calls[0] += 1
        return (np.nan, *values(z)[1:]) if first <= calls[0] <= last else values(z)

    problem._numbers = numbers  # type: ignore[method-assign]
    return calls
