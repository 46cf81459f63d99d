"""The interface of bridges. A bridge reformulates a problem as a simpler one, and maps trajectories of either to the
other.
"""

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

#: A control below this fraction of its typical size does not determine the sign of its bound.
_NOTHING = 1e-4


@dataclasses.dataclass(frozen=True, eq=False)
class Statement:
    """The statement of a phase: system, objective, conditions and parameters.

    Attributes:
        dynamics, objective: as they are before a bridge.
        rows: the constraints of each node with constraints, by name. The first and the last node are always keys.
        controls: the interpolation between nodes of each continuous control, by its name.
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
        """A copy with some expressions of the objective and the constraints replaced.

        Args:
            put: returns the expression that replaces its first argument; the second argument is whether that belongs to
                the last node.
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
    """The suffix that names a node in the names of its conditions."""
    return {0: "initial", last: "final"}.get(node, f"node {node}")


def extended(
    dynamics: Dynamics,
    rates: Mapping[State, Any],
    rows: Mapping[str, Constraint],
    put: Callable[[Expr], Expr] = lambda e: e,
    controls: Collection[Control] = (),
    dropped: Collection[str] = (),
) -> Dynamics:
    """A compiled copy of a system with additional states, constraints and controls, and with the same compile options.

    Args:
        put: returns the expression that replaces an expression of the system.
        controls: additional controls, besides those that rates and constraints read.
        dropped: names of the controls that are removed.
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
    """States and controls of a trajectory, which bridges transform.

    Attributes:
        ts: (nodes,) times.
        xs, us: states at the nodes and controls over the intervals, by name.
        params: values of the parameters.
        sizes: typical sizes of controls, by name; may be incomplete.
    """

    ts: Array
    xs: dict[str, Array]
    us: dict[str, Array]
    params: Mapping[str, Array]
    sizes: Mapping[str, Array] = dataclasses.field(default_factory=dict)

    def sized(self, side: float = 1.0) -> Path:
        """A copy in which controls that are close to zero are replaced by plus or minus their typical sizes."""
        sizes = {name: side * size for name, size in self.sizes.items()}
        return dataclasses.replace(self, xs=_sized(self.xs, sizes), us=_sized(self.us, sizes))

    def add_bounds(self, bounds: Mapping[str, Expr]) -> None:
        """Initialise bounds slightly above the values that they bound; controls that are nearly zero are replaced by
        typical sizes.
        """
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
    """A reformulation of a problem as a simpler one, with the map of trajectories in both directions. This base class
    changes nothing.

    Attributes:
        statement: the reformulated problem.
        free: the parameters that the bridge introduces, with limits (low, high).
    """

    statement: Statement
    free: Mapping[str, tuple[Any, Any]] = {}

    def complete(self, guess: Path) -> None:
        """Add initial values of the states and controls that this bridge introduced."""

    def parameters(self, guess: Path, phase: Any) -> dict[str, Array]:
        """Initial values of the parameters that this bridge introduced, from a complete guess."""
        return {}

    def forward(self, path: Path) -> None:
        """Transform a trajectory of the original problem: add the variables of this bridge, with tight bounds."""

    def back(self, xs: dict[str, Any], us: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
        """Transform a trajectory of the reformulated problem: remove the variables of this bridge from states and
        controls.
        """
        return xs, us
