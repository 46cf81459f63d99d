"""The interface of integration methods, and `Stepper`, a method with a system, which the loop over steps calls."""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp

from ..errors import ModelError
from ..jax_inside import spread
from ..scalar.array_primitive import on_any_mesh
from ..scalar.backends import JAX
from ..scalar.small_call import stored_once
from ..system.dynamics import Arrays, Dynamics
from .charts.chart import compensated
from .charts.coordinates import Blocks, StateCoordinates, StoredState
from .controls import Signals
from .step_control import Tolerances

#: State of a method between steps: a pytree of arrays of the precision of the system's state.
Carry: TypeAlias = Any


class VectorField(NamedTuple):
    """The right-hand side of a system within one step: x' = f(t, x, u(t), params).

    Attributes:
        dynamics: the compiled system.
        controls: the prepared controls as a function of the times within the step.
        params: the prepared parameters.
        clock: the time that rates see.
    """

    dynamics: Dynamics
    controls: Callable[[jax.Array], Arrays]
    params: Arrays
    clock: Callable[[jax.Array], jax.Array] = lambda t: t

    def __call__(self, t: jax.Array, x: Arrays) -> Arrays:
        """The rates at a time within the step."""
        return self.dynamics.functions.vector_field(self.clock(t), x, self.controls(t), self.params)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class StepAttempt:
    """A step that may be rejected."""

    y: Any  # the stored state at its end
    carry: Any  # what the next step begins with
    #: Estimates of the error of the step, in the coordinates around its start; the first one of lowest order but one,
    #: the second, where a method has two, of lowest order. None where steps are fixed.
    errors: Any
    evaluations: Any  # of the right-hand side, a number or an array
    solved: Any = None  # whether the equations of the step were solved; None where it has none
    slopes: Any = None  # what `between` reads, where the method has it


class Method(ABC):
    """A one-step method. Methods with equal coefficients are equal, and have equal hashes.

    To define a method, subclass this; `tx.integrate` accepts any method with fixed steps. For adaptive steps, a method
    with an error estimate also defines `error_order` and `attempt`. A method that uses data of the previous step
    defines `before` and `follow`, or `begin` and `resume` for adaptive steps.
    """

    @property
    @abstractmethod
    def name(self) -> str:
        """The name in tables."""

    @property
    @abstractmethod
    def order(self) -> int:
        """The order of convergence."""

    @property
    @abstractmethod
    def evaluations(self) -> int:
        """Evaluations of the right-hand side in a step of `advance`."""

    def evaluations_of(self, dynamics: Dynamics) -> int:
        """Evaluations of the right-hand side in a step of `advance` on one system."""
        return self.evaluations

    def check(self, dynamics: Dynamics) -> None:
        """Raise ModelError, with the reason, for a system that the method cannot integrate; most methods accept all
        systems.
        """
        return

    def coordinates(self, dynamics: Dynamics) -> StateCoordinates:
        """The stored form of the states of a system, with coordinates around the start of a step.

        Raises:
            ModelError: the method has no such coordinates; it defines `stored` instead.
        """
        raise ModelError(f"{self.name} has no coordinates around the start of a step")

    def stored(self, dynamics: Dynamics, params: Arrays) -> StoredState:
        """The stored form of the states of a system between steps: by their coordinates, unless a method overrides
        this.
        """
        return self.coordinates(dynamics)

    @abstractmethod
    def advance(self, field: VectorField, t: jax.Array, y: Blocks, h: jax.Array) -> Blocks:
        """The stored state after one step of length h. Pure and traceable."""

    def part(self, field: VectorField, t: jax.Array, y: Blocks, h: jax.Array, tolerances: Tolerances | None) -> Blocks:
        """The step of `advance` as a part of an adaptive step with these tolerances, to a saved time or an event."""
        return self.advance(field, t, y, h)

    @property
    def error_order(self) -> int:
        """The power of the step length with which the estimated error of one step decreases.

        Raises:
            ModelError: the method does not estimate its error.
        """
        raise ModelError(
            f"{self.name} does not estimate its error, so it cannot choose its own steps.\n"
            "  fix: pass dt or steps in place of rtol, or use an embedded pair: tx.RKMK(tx.tableaus.TSIT5)"
        )

    def rate(self, field: VectorField, t: jax.Array, y: Blocks) -> Blocks:
        """The rate of a stored state."""
        local = self.coordinates(field.dynamics)
        return local.rate(field(t, local.value(y)))

    #: Whether `advance` solves equations by `jax.lax.custom_root`.
    solves: bool = False

    # ---- fixed steps ---------------------------------------------------------------------------------------------

    def before(self, dynamics: Dynamics, y: Blocks) -> Carry:
        """The initial carry of `follow`."""
        return ()

    def follow(self, field: VectorField, t: jax.Array, y: Blocks, carry: Carry, h: jax.Array) -> StepAttempt:
        """The step of `advance`, given the carry of the step before. Pure and traceable."""
        return StepAttempt(self.advance(field, t, y, h), carry, (), self.evaluations_of(field.dynamics))

    def sampled(self, field: VectorField, t: jax.Array, y: Blocks, carry: Carry, h: jax.Array) -> StepAttempt:
        """The step of `follow` with the slopes that `between` reads, where the method has it."""
        return self.follow(field, t, y, carry, h)

    # ---- steps chosen by tolerances ------------------------------------------------------------------------------

    #: Evaluations of the right-hand side in `resume`.
    resume_evaluations: int = 1

    def begin(self, dynamics: Dynamics, y: Blocks, rate: Blocks) -> Carry:
        """The initial carry of `attempt`: the rate at the start, unless a method overrides this."""
        return rate

    def resume(self, field: VectorField, t: jax.Array, y: Blocks, carry: Carry) -> Carry:
        """The carry of `attempt` at a time where rates may have jumped."""
        return self.rate(field, t, y)

    def attempt(
        self, field: VectorField, t: jax.Array, y: Blocks, carry: Carry, h: jax.Array, tolerances: Tolerances
    ) -> StepAttempt:
        """One step of length h with its error. Pure and traceable.

        Args:
            tolerances: the tolerances of the error, for methods that solve equations to a fraction of these.
        """
        raise NotImplementedError

    # ---- polynomials between the ends of a step ------------------------------------------------------------------

    def need_polynomial(self) -> None:
        """Raise ModelError where the method has no polynomial between the ends of its steps, for `between`."""
        raise ModelError(
            f"{self.name} has no polynomial between the ends of its steps.\n"
            "  fix: leave between out, or use tx.RKMK(tableau)"
        )

    def between(self, dynamics: Dynamics, y: Blocks, h: jax.Array, slopes: Any, share: jax.Array) -> Blocks:
        """The stored state at a fraction of a step of length h from y. Pure and traceable."""
        raise NotImplementedError

    # ---- derivatives and values ----------------------------------------------------------------------------------

    def increment(self, field: VectorField, t: jax.Array, x: Arrays, h: jax.Array) -> Arrays:
        """The tangent eta of one step, name -> (dimension,), so that the step ends at x Exp(eta). For derivatives.

        Raises:
            ModelError: the method has no such form.
        """
        raise ModelError(
            f"{self.name} does not provide the tangent of its step, which derivatives of steps need.\n"
            "  fix: use tx.RKMK(tableau), or a chart tx.charts.Exponential(...)"
        )

    def step(self, field: VectorField, t: jax.Array, x: Arrays, h: jax.Array) -> Arrays:
        """The state after one step of length h, from a prepared state. Pure and traceable."""
        stored = self.stored(field.dynamics, field.params)
        return stored.value(self.advance(field, t, stored.enter(x), h))

    def step_in_arrays(self, dynamics: Dynamics, t: Any, x: Arrays, u: Arrays, params: Arrays, h: Any) -> Arrays:
        """The state after one step of length h with constant controls, with arrays throughout: for other languages."""
        field = VectorField(Dynamics(dynamics.functions.run_by(JAX())), lambda _: u, params)
        return self.step(field, t, x, h)


class ChartMethod(Method):
    """Base class of methods with a tableau and a chart, the attributes `tableau` and `chart` of a subclass."""

    tableau: Any
    chart: Any

    @property
    def name(self) -> str:
        return f"{self.tableau.name}, {self.chart!r}"

    @property
    def order(self) -> int:
        return int(self.tableau.order)

    @property
    def error_order(self) -> int:
        return int(self.tableau.error_order)

    def coordinates(self, dynamics: Dynamics) -> StateCoordinates:
        return compensated(self.chart, dynamics.group)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Stepper:
    """A method, a system and its inputs. A pytree: dynamics and method are structure, the rest are inputs."""

    dynamics: Dynamics = dataclasses.field(metadata={"static": True})
    method: Method = dataclasses.field(metadata={"static": True})
    signals: Signals  # the prepared controls
    params: dict[str, Any]  # prepared; not `Arrays`: JAX rebuilds pytrees with stand-ins for arrays
    #: Whether steps end at the rows of tables.
    within: bool = dataclasses.field(default=False, metadata={"static": True})
    #: Whether rates see times just inside of a step in place of its ends, because they may jump there: a step that ends
    #: at a jump must not see the other side.
    inward: bool = dataclasses.field(default=False, metadata={"static": True})
    #: 1.0, or -1.0 for an integration backward in time; None: forward. Loops over steps run on a clock that goes
    #: forward, the time by the direction.
    direction: Any = None
    #: The allowed error of adaptive steps of a method that solves equations: parts of steps are solved to these.
    tolerances: Tolerances | None = None

    @property
    def coordinates(self) -> StateCoordinates:
        """Coordinates around the start of a step, of methods that have them."""
        return self.method.coordinates(self.dynamics)

    @property
    def stored(self) -> StoredState:
        """How states are stored between steps."""
        return self.method.stored(self.dynamics, self.params)

    @property
    def in_arrays(self) -> Stepper:
        """This stepper with rates as arrays, for a step that becomes scalars as a whole."""
        return dataclasses.replace(self, dynamics=Dynamics(self.dynamics.functions.run_by(JAX())))

    @property
    def outside_loops(self) -> Stepper:
        """This stepper for functions outside the kernel of a loop."""
        return dataclasses.replace(self, dynamics=Dynamics(self.dynamics.functions.outside_loops()))

    def clock(self, t: Any) -> Any:
        """Converts a time in s to the clock of the loop, or the reverse; lengths of time are converted alike."""
        return t if self.direction is None else self.direction * t

    def field(self, t: jax.Array, h: jax.Array) -> VectorField:
        """The right-hand side within the step from t to t + h in s, h of either sign."""
        during = self.signals.during(self.dynamics, t, h, self.within)
        if not self.inward:
            return VectorField(self.dynamics, during, self.params)

        def clock(time: jax.Array) -> jax.Array:
            # The ends of the step are moved inside of it by a few units of round-off.
            small = 4.0 * jnp.finfo(time.dtype).eps
            hair = jax.lax.stop_gradient(jnp.maximum(small * jnp.abs(t), small * jnp.abs(t + h)))
            first, last = jnp.where(h < 0.0, t + h, t) + hair, jnp.where(h < 0.0, t, t + h) - hair
            return jnp.where(time < first, first, jnp.where(time > last, last, time))

        return VectorField(self.dynamics, lambda time: during(clock(time)), self.params, clock)

    # ---- what loops over steps call, with times and lengths on their clock -------------------------------------------

    def _in_s(self, t: jax.Array, h: jax.Array) -> tuple[VectorField, jax.Array, jax.Array]:
        t, h = self.clock(t), self.clock(h)
        return self.field(t, h), t, h

    def advance(self, t: jax.Array, y: Blocks, h: jax.Array) -> Blocks:
        """The stored state after a step of length h."""
        field, t, h = self._in_s(t, h)
        return self.method.part(field, t, y, h, self.tolerances)

    def follow(self, t: jax.Array, y: Blocks, carry: Carry, h: jax.Array, sampled: bool = False) -> StepAttempt:
        """The step of `advance` after a step that returned `carry`; with `sampled`, also the slopes of the step if it
        has any.
        """
        field, t, h = self._in_s(t, h)
        return (self.method.sampled if sampled else self.method.follow)(field, t, y, carry, h)

    def rate(self, t: jax.Array, y: Blocks, h: jax.Array) -> Blocks:
        """The rate in s at the start of a step of about length h."""
        field, t, _ = self._in_s(t, h)
        return self.method.rate(field, t, y)

    def resume(self, t: jax.Array, y: Blocks, carry: Carry, h: jax.Array) -> Carry:
        """The carry of `attempt` where rates may have jumped before a step of length h."""
        field, t, _ = self._in_s(t, h)
        return self.method.resume(field, t, y, carry)

    def attempt(self, t: jax.Array, y: Blocks, carry: Carry, h: jax.Array, tolerances: Tolerances) -> StepAttempt:
        """A step of length h that may be rejected, with its error."""
        field, t, h = self._in_s(t, h)
        return self.method.attempt(field, t, y, carry, h, tolerances)

    def between(self, y: Blocks, h: jax.Array, slopes: Any, share: jax.Array) -> Blocks:
        """The stored state at a share of a step of length h from y, of a method that has a polynomial."""
        return self.method.between(self.dynamics, y, self.clock(h), slopes, share)

    def first_step(
        self, tolerances: Tolerances, t: jax.Array, y: Blocks, rate: Blocks, fallback: Any, room: Any
    ) -> jax.Array:
        """A step whose error should be close to the tolerance, estimated from the rate and a short Euler step.

        Pure and traceable; `fallback` if the rates are not informative.

        Source: Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I (1993), section II.4,
        starting step size.
        """
        local, order = self.coordinates, self.method.error_order

        def size(e: Blocks) -> jax.Array:
            return jnp.sqrt(tolerances.mean_square(local, e, y, y))

        slope = stored_once(local.first_slope(y, rate))
        reach, speed = tolerances.reach(local, y), size(slope)
        short = jnp.where((reach > 1e-5) & (speed > 1e-5), 0.01 * reach / speed, fallback)
        # Controls beyond the end may not be defined.
        short = jnp.minimum(jnp.where(jnp.isfinite(short), short, fallback), room)
        z = jax.tree.map(lambda k: self.clock(short) * k, slope)
        moved = stored_once(local.move(y, z))
        later = local.slope(z, moved, stored_once(self.rate(t + short, moved, 1e-3 * short)))
        bend = size(jax.tree.map(jnp.subtract, later, slope)) / short
        largest = jnp.maximum(speed, bend)
        h = jnp.where(largest > 1e-15, (0.01 / largest) ** (1.0 / order), jnp.maximum(fallback, 1e-3 * short))
        h = jnp.minimum(100.0 * short, h)
        return jnp.where(jnp.isfinite(h) & (h > 0.0), h, fallback)


def jitted(make: Callable[[], Callable[..., Any]], stepper: Stepper, *rest: Any) -> Any:
    """The jitted function that `make` returns, of a stepper and other pytrees, cached with the stepper's system."""
    function, leaves, _ = flattened(make, stepper, *rest)
    return on_any_mesh(function, *leaves) if spread(leaves) else function(*leaves)


def flattened(
    make: Callable[[], Callable[..., Any]], stepper: Stepper, *rest: Any
) -> tuple[Callable[..., Any], list[Any], Any]:
    """The jitted function on the arrays of its arguments, those arrays, and their structure.

    JAX caches the traces of a function as long as the function exists, so each system has its own functions, which are
    freed with it. Traces use a copy of the system, so that they do not keep the system alive. JAX caches structures of
    arguments even longer, so the function takes arrays, and contains their structure.
    """
    functions = stepper.dynamics.functions
    twin = functions.loops.get(Dynamics, lambda: Dynamics(functions.twin()))
    leaves, structure = jax.tree.flatten((dataclasses.replace(stepper, dynamics=twin), *rest))

    def flat() -> Callable[..., Any]:
        function = make()
        # With jit disabled arrays of NumPy are not converted.
        return jax.jit(lambda *leaves: function(*jax.tree.unflatten(structure, map(jnp.asarray, leaves))))

    return functions.loops.get((make, structure), flat), leaves, structure
