"""What every integration method offers to the loops over steps."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import jax

from ..errors import ModelError
from ..lowering import Dynamics
from ..lowering.dynamics import Arrays
from .charts.whole import Blocks, StateCoordinates, StoredState
from .tolerances import Tolerances

__all__ = ["Attempt", "Carry", "ControlsAt", "Method"]

#: The prepared controls at a stage time.
ControlsAt: TypeAlias = Callable[[jax.Array], Arrays]

#: What a method carries from one step to the next, its own affair: a pytree of arrays of the state's precision.
Carry: TypeAlias = Any


class Attempt(NamedTuple):
    """A step that may be taken back.

    Attributes:
        y: the stored state at its end.
        carry: what the next step begins with.
        errors: estimates of the error of the step, in the coordinates around its start; the first one of lowest order
            but one, the second, where a method has two, of lowest order. None where steps are fixed.
        evaluations: of the right-hand side, a number or an array.
        solved: whether the equations of the step were solved; None where it has none.
    """

    y: Blocks
    carry: Carry
    errors: tuple[Blocks, ...]
    evaluations: Any
    solved: jax.Array | None = None


class Method(ABC):
    """A one-step method. A value: methods are equal where they mean the same, and hash accordingly.

    A new method subclasses this; `tx.integrate` takes any with fixed steps. One that estimates its own error also gives
    `error_order` and `attempt`, and chooses its own steps. One that learns from the step before gives `before` and
    `follow`, or `begin` and `resume` where steps are chosen.
    """

    @property
    @abstractmethod
    def name(self) -> str:
        """How tables call it."""

    @property
    @abstractmethod
    def order(self) -> int:
        """The order of convergence."""

    @property
    @abstractmethod
    def evaluations(self) -> int:
        """Evaluations of the right-hand side in a step of `advance`."""

    def evaluations_of(self, dynamics: Dynamics) -> int:
        """The same for one system, where a method takes more for some."""
        return self.evaluations

    def check(self, dynamics: Dynamics) -> None:
        """Refuse a system that the method cannot fly. Raises ModelError with the reason; most methods fly all."""
        return

    def coordinates(self, dynamics: Dynamics) -> StateCoordinates:
        """How the states of a system are stored, with coordinates around the start of a step.

        Raises:
            ModelError: the method has no such coordinates; then it says with `stored` how states are stored.
        """
        raise ModelError(f"{self.name} has no coordinates around the start of a step")

    def stored(self, dynamics: Dynamics, params: Arrays) -> StoredState:
        """How the states of a system are stored between steps: by their coordinates, unless a method knows better."""
        return self.coordinates(dynamics)

    @abstractmethod
    def advance(
        self, dynamics: Dynamics, t: jax.Array, y: Blocks, u_at: ControlsAt, params: Arrays, h: jax.Array
    ) -> Blocks:
        """The stored state after one step of length h. Pure and traceable."""

    @property
    def error_order(self) -> int:
        """The power of the step with which the estimated error of one step falls.

        Raises:
            ModelError: the method does not estimate its error.
        """
        raise ModelError(
            f"{self.name} does not estimate its error, so it cannot choose its own steps.\n"
            "  fix: give dt or steps in place of rtol, or take a pair: tx.RKMK(tx.tableaus.TSIT5)"
        )

    def rate(self, dynamics: Dynamics, t: jax.Array, y: Blocks, u_at: ControlsAt, params: Arrays) -> Blocks:
        """The rate of a stored state."""
        local = self.coordinates(dynamics)
        return local.rate(dynamics._functions.vector_field(t, local.value(y), u_at(t), params))

    # ---- fixed steps ---------------------------------------------------------------------------------------------

    def before(self, dynamics: Dynamics, y: Blocks) -> Carry:
        """What `follow` is given at the start of a flight."""
        return ()

    def follow(
        self, dynamics: Dynamics, t: jax.Array, y: Blocks, carry: Carry, u_at: ControlsAt, params: Arrays, h: jax.Array
    ) -> Attempt:
        """The step of `advance`, after a step that left `carry`. Pure and traceable."""
        return Attempt(self.advance(dynamics, t, y, u_at, params, h), carry, (), self.evaluations_of(dynamics))

    # ---- steps chosen by tolerances ------------------------------------------------------------------------------

    #: Evaluations of the right-hand side in `resume`.
    resume_evaluations: int = 1

    def begin(self, dynamics: Dynamics, y: Blocks, rate: Blocks) -> Carry:
        """What `attempt` is given at the start of a flight: the rate there, if a method wants nothing else."""
        return rate

    def resume(
        self, dynamics: Dynamics, t: jax.Array, y: Blocks, carry: Carry, u_at: ControlsAt, params: Arrays
    ) -> Carry:
        """What `attempt` is given at a time where rates may have jumped."""
        return self.rate(dynamics, t, y, u_at, params)

    def attempt(
        self,
        dynamics: Dynamics,
        t: jax.Array,
        y: Blocks,
        carry: Carry,
        u_at: ControlsAt,
        params: Arrays,
        h: jax.Array,
        tolerances: Tolerances,
    ) -> Attempt:
        """One step of length h with its error. Pure and traceable.

        Args:
            tolerances: what is allowed, for methods that solve equations no better than that.
        """
        raise NotImplementedError

    # ---- derivatives and values ----------------------------------------------------------------------------------

    def increment(
        self, dynamics: Dynamics, t: jax.Array, x: Arrays, u_at: ControlsAt, params: Arrays, h: jax.Array
    ) -> Arrays:
        """The tangent eta of one step, name -> (dimension,), so that the step ends at x Exp(eta). For derivatives.

        Raises:
            ModelError: the method has no such form.
        """
        raise ModelError(
            f"{self.name} gives no tangent of its step, which derivatives of steps need.\n"
            "  fix: use tx.RKMK(tableau), or a chart tx.charts.Exponential(...)"
        )

    def step(
        self, dynamics: Dynamics, t: jax.Array, x: Arrays, u_at: ControlsAt, params: Arrays, h: jax.Array
    ) -> Arrays:
        """The state after one step of length h, from prepared arguments. Pure and traceable."""
        stored = self.stored(dynamics, params)
        return stored.value(self.advance(dynamics, t, stored.enter(x), u_at, params, h))
