"""Bridges: a statement becomes a simpler one, and a trajectory of that becomes one of the statement again."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection, Mapping
from typing import Any

import numpy as np
from numpy import ndarray as Array

from ....expr import Constraint, Control, Expr, Parameter, State, leaves_of
from ....system import System
from ....system.dynamics import Dynamics, compile
from ..controls import Spline
from ..statement import Objective
from ..terms import above, bounds_along

#: A control of less than this share of its size says nothing of it.
_NOTHING = 1e-4


@dataclasses.dataclass(frozen=True, eq=False)
class Statement:
    """The statement of a phase: system, objective, conditions and parameters.

    Attributes:
        dynamics, objective: as they are before a bridge.
        rows: number of a node -> its constraints by name; the first and the last node are always there.
        controls: name of a continuous control -> how it goes on between nodes.
    """

    dynamics: Dynamics
    objective: Objective
    rows: Mapping[int, Mapping[str, Any]]
    controls: Mapping[str, Spline]

    @property
    def last(self) -> int:
        """The number of the last node."""
        return max(self.rows)

    def substituted(self, put: Callable[[Expr, bool], Expr]) -> Statement:
        """A copy with substituted expressions in objective and constraints.

        Args:
            put: gives another expression for one; its second argument says whether that is of the last node.
        """
        final, running = self.objective.final, self.objective.running
        objective = type(self.objective)(
            None if final is None else put(final, True), running=None if running is None else put(running, False)
        )
        rows = {
            k: {
                name: type(c)(put(c.lhs, k == self.last), put(c.rhs, k == self.last)) for name, c in constraints.items()
            }
            for k, constraints in self.rows.items()
        }
        return dataclasses.replace(self, objective=objective, rows=rows)


def place_of(node: int, last: int) -> str:
    """The name of a node in the names of its conditions."""
    return {0: "initial", last: "final"}.get(node, f"node {node}")


def extended(
    dynamics: Dynamics,
    rates: Mapping[State, Any],
    rows: Mapping[str, Constraint],
    put: Callable[[Expr], Expr] = lambda e: e,
    controls: Collection[Control] = (),
    dropped: Collection[str] = (),
) -> Dynamics:
    """A system with more states, constraints and controls, compiled as it was.

    Args:
        put: gives another expression for each of the system.
        controls: added, beside those that rates and constraints read.
        dropped: names of controls that go.
    """
    system = dynamics.system
    constraints = {n: type(c)(put(c.lhs), put(c.rhs)) for n, c in {**system.constraints, **rows}.items()}
    every: dict[State | str, Any] = {state: put(system.rates[state.name]) for state in system.states}
    known = {leaf.name for leaf in (*system.parameters, *system.controls, *controls)}
    read = leaves_of(*(e for e in rates.values() if isinstance(e, Expr)), *rows.values())
    new = {leaf.name: leaf for leaf in read if isinstance(leaf, (Parameter, Control)) and leaf.name not in known}
    left = [
        c for c in (*system.controls, *(e for e in new.values() if isinstance(e, Control))) if c.name not in dropped
    ]
    return compile(
        System(
            rates=every | dict(rates.items()),
            outputs={name: put(e) for name, e in system.outputs.items()},
            constraints=constraints,
            controls=(*left, *controls),
            parameters=(*system.parameters, *(e for e in new.values() if isinstance(e, Parameter))),
        ),
        outputs=list(dynamics.functions.families["outputs"]),
        bake=dynamics.baked,
        backend=dynamics.backend,
    )


@dataclasses.dataclass
class Path:
    """States and controls at nodes, or over intervals, which bridges transform.

    Attributes:
        ts: (nodes,) times.
        xs, us: by name.
        params: values of the parameters.
        sizes: of controls, by name, where they are known.
    """

    ts: Array
    xs: dict[str, Array]
    us: dict[str, Array]
    params: Mapping[str, Array]
    sizes: Mapping[str, Array] = dataclasses.field(default_factory=dict)

    def sized(self, side: float = 1.0) -> Path:
        """A copy in which controls close to zero have their typical sizes, or the negatives of these."""
        sizes = {name: side * size for name, size in self.sizes.items()}
        return dataclasses.replace(self, xs=_sized(self.xs, sizes), us=_sized(self.us, sizes))

    def add_bounds(self, bounds: Mapping[str, Expr]) -> None:
        """Start bounds slightly above what they bound; controls that are nearly zero count with typical sizes."""
        sized = self.sized()
        for name, values in bounds_along(bounds, sized.xs | sized.us, self.params).items():
            (self.us if name in self.us else self.xs)[name] = above(values)


def _sized(values: Mapping[str, Array], sizes: Mapping[str, Array]) -> dict[str, Array]:
    sized = dict(values)
    for name, size in sizes.items():
        if name in sized and np.abs(sized[name]).max(initial=0.0) <= _NOTHING * np.abs(size).max(initial=0.0):
            sized[name] = np.broadcast_to(size.reshape(sized[name].shape[1:]), sized[name].shape)
    return sized


class Bridge:
    """A map of a statement to a simpler one, and of its trajectories back. This one adds nothing.

    Attributes:
        statement: what it becomes.
        free: parameters that it added, with limits (low, high).
    """

    statement: Statement
    free: Mapping[str, tuple[Any, Any]] = {}

    def complete(self, guess: Path) -> None:
        """Add initial values of the states and controls that this bridge introduced."""

    def parameters(self, guess: Path, phase: Any) -> dict[str, Array]:
        """Initial values of the parameters that this bridge introduced, from a complete guess."""
        return {}

    def forward(self, path: Path) -> None:
        """Add what this bridge introduced to a trajectory as stated; bounds are tight."""

    def back(self, xs: dict[str, Any], us: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
        """Remove what this bridge introduced from states and controls."""
        return xs, us
