"""What runs of a problem are made of, compiled: first states, steps in a row, and a look at what was found."""

from __future__ import annotations

import functools
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ..lowering.array_call import array_call, is_one_kernel
from ..lowering.on_disk import compiled
from . import estimate, scaling
from .decisions import CURVED, Decisions, Memory, Opening
from .interior_point import InteriorPoint
from .iterate import Scales, State
from .stride import Orders, Stride, no_slopes, ordered, stride
from .transcribed import Derivatives, Given, Point, Transcribed, Values, jitted

#: Unknowns of a stage up to which steps run as one kernel: beyond, products of matrices take XLA's threads.
_SMALL = 40
#: Where a solution is no minimum scales of entries of a vector may be so far apart.
_LEVEL = 10.0
#: A slack times its multiplier is not a barrier parameter's if it is less than this share of it.
_OFF = 1e-3


class _Parts(NamedTuple):
    """Functions that others are made of: by themselves, or each compiled."""

    start: Callable[..., State]
    open: Callable[..., Opening]
    stride: Any  # compiled apart
    level: Callable[..., State]
    to_probe: Callable[..., State]


class Steps:
    """Pure functions of one problem.

    Attributes:
        probe, bent: a step from memory of the damping `probe` tries none, a third of it, then more; raised above `bent`
            the objective falls to second order along what the constraints leave free.
        one_kernel: whether a stride is one, so that many cases at once run as its rows; known once it is prepared.
        opening_of, stride_of, raised_of: what is compiled then.
    """

    probe, bent = 3.0 * CURVED, 1.5 * CURVED

    def __init__(self, shooting: Transcribed, method: InteriorPoint, tolerance: float) -> None:
        self._shooting, self._method = shooting, method
        decisions = self._decisions = Decisions(shooting, tolerance)
        small = shooting.n + shooting.m + shooting.border.size <= _SMALL

        def whole(function: Callable[..., Any]) -> Any:
            """As one kernel, and traced once."""
            return jax.jit(functools.partial(array_call, function) if small else function)

        own = functools.partial(stride, method, decisions, tolerance)
        parts = _Parts(method.start, whole(self._open), whole(own), self._level, self._to_probe)
        self._parts = _Parts(*(jitted(part, 0) for part in parts))._replace(stride=jitted(parts.stride))
        self.start, self.levelled = self._parts.start, self._parts.level
        self.opening_of, self.raised_of = (functools.partial(own, parts) for own in (self._first, self._probed))
        self.stride_of = parts.stride
        self.opening = jitted(decisions.opening, 0)
        self.renewed = jitted(decisions.renewed, 0)
        self.signs = jitted(decisions.signs, 0)
        self.scales = jitted(self._scales, 0)
        self.rescaled = jitted(method.rescaled, 0)
        self._bound = jitted(functools.partial(estimate.is_bound, method, shooting.steered), 0)
        self.no_slopes, self.no_memory = no_slopes(shooting), jax.device_put(decisions.no_memory())
        self.one_kernel = False
        self._opening: Any
        self._raised: Any

    def prepare(self, point: Point, given: Given) -> None:
        """Compile what every run needs, side by side. Compiled functions do not care who calls them, as jit does."""
        with ThreadPoolExecutor() as pool:

            def job(program: Any) -> Future[Any]:
                """What was traced here is compiled in another thread."""
                return pool.submit(compiled, program, program.lower(), 1)

            state = jax.eval_shape(self.start, point, given, self._unit)
            program = self._parts.stride.trace(state, self.no_slopes, self.no_memory, given, ordered())
            self.one_kernel = is_one_kernel(program)
            jobs = [job(program)]
            if self.one_kernel:  # else it would be compiled again in each of them
                opened, raised = jitted(self.opening_of), jitted(self.raised_of)
                jobs += [job(opened.trace(point, given)), job(raised.trace(state, given))]
            found = [own.result() for own in jobs]
        self._parts = self._parts._replace(stride=found[0])
        apart = [functools.partial(self._first, self._parts), functools.partial(self._probed, self._parts)]
        self._opening, self._raised = found[1:] or apart

    def shapes(self, point: Point, given: Given) -> tuple[Point, Given, Values, Scales]:
        """Of what a run ends with."""
        state = jax.eval_shape(self.start, point, given, self._unit)
        return point, given, state.values, state.scales

    def opened(self, point: Point, given: Given) -> Opening:
        """The first state at a point, in scales that fit."""
        found: Opening = self._opening(point, given)
        return found

    def steps(
        self, state: State, slopes: Derivatives, given: Given, orders: Orders, memory: Memory | None = None
    ) -> Stride:
        """Steps as ordered; without a memory nothing may be decided."""
        return self._parts.stride(state, slopes, self.no_memory if memory is None else memory, given, orders)

    def looked_at(self, state: State, given: Given) -> tuple[Derivatives, State]:
        """The derivatives at a state, and the state measured."""
        found = self.steps(state, self.no_slopes, given, ordered(look=True))
        return found.slopes, found.state

    def begun_in(self, scales: Scales, point: Point, given: Given) -> tuple[State, jax.Array]:
        """The first state in given scales, and whether limits and costs say how far every control may go."""
        first = unweighed(self.start(point, given, self._unit))
        state = self.start(point, given, scales)
        return state, self._bound(state, self.looked_at(first, given)[0])

    def raised(self, state: State, given: Given) -> float:
        """What the diagonal is raised by where a solution is looked at for bends along what constraints leave free."""
        return float(self._raised(state, given))

    # ---- what is compiled ---------------------------------------------------------------------------------------

    @property
    def _unit(self) -> Scales:
        return scaling.unit_scales(self._shooting)

    def _first(self, own: _Parts, point: Point, given: Given) -> Opening:
        state = unweighed(own.start(point, given, self._unit))
        looked_at = own.stride(state, self.no_slopes, self.no_memory, given, ordered(look=True))
        return own.open(looked_at.slopes, state, given)

    def _open(self, slopes: Derivatives, state: State, given: Given) -> Opening:
        """The same from a state in scales of 1 and its derivatives, second ones of the objective."""
        scales, sloped = scaling.measured(self._shooting, state.point, slopes, state.scales, state.values.defects)
        seen = scaling.not_below(scales, scales._replace(cost=jnp.zeros(())), sloped)[1]
        begun = self._method.start(state.point, given, scales)
        return self._decisions.opening(
            begun, seen, estimate.is_bound(self._method, self._shooting.steered, begun, slopes)
        )

    def _scales(self, point: Point, slopes: Derivatives, before: Scales) -> tuple[Scales, jax.Array]:
        """Scales at a point, and by how much those before were off."""
        found = scaling.measured(self._shooting, point, slopes, before)[0]
        return found, scaling.change(found, before)

    def _level(self, state: State) -> State:
        """The state in scales in which bends count along what hardly moves at a saddle, too."""
        levels = scaling.levelled(self._shooting, state.scales)
        far = scaling.change(levels, state.scales) > _LEVEL
        return jax.lax.cond(far, lambda: self._method.rescaled(state, levels), lambda: state)

    def _probed(self, own: _Parts, state: State, given: Given) -> jax.Array:
        """What a step from a solution raises the diagonal by."""
        state = own.level(state)
        slopes = own.stride(state, self.no_slopes, self.no_memory, given, ordered(look=True)).slopes
        found: jax.Array = own.stride(own.to_probe(state), slopes, self.no_memory, given, ordered(most=1)).state.raised
        return found

    def _to_probe(self, state: State) -> State:
        """The state from which a step tells.

        Solvers of others end with slacks of zero: with their multipliers they make the barrier parameter. Slacks that
        nearly do are left: at the apex of a cone a larger one is a point outside of it, where it bends the other way.
        """
        barrier = state.barrier
        off = self._method.inequality & (state.slack * state.rows < _OFF * barrier)
        slack = jnp.maximum(state.slack, barrier / jnp.maximum(state.rows, jnp.sqrt(barrier)))
        slack = jnp.where(off, slack, state.slack)
        rows = jnp.where(off, jnp.maximum(state.rows, barrier / slack), state.rows)
        return state._replace(slack=slack, rows=rows, damping=jnp.full_like(state.damping, self.probe))


def unweighed(state: State) -> State:
    """A state whose multipliers are zero: second derivatives are the objective's."""
    return state._replace(dynamics=jnp.zeros_like(state.dynamics), rows=jnp.zeros_like(state.rows))
