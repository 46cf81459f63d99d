"""Implicit Runge-Kutta methods in coordinates around each step, for stiff systems and for symmetric integration."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from ...checks import instance
from ...errors import ModelError
from ...jax_inside import opened
from ...scalar.backends import XLA
from ...scalar.small_call import small_call
from ...system.dynamics import Dynamics
from ..charts.chart import Chart, Exponential, chart_of
from ..charts.coordinates import Blocks
from ..loop.loop import all_finite
from ..method import Carry, ChartMethod, StepAttempt, VectorField
from ..step_control import Tolerances
from ..tableaus import CollocationTableau
from .newton import Factors, Parts, combined, newton

#: The most Newton iterations of a step: of one that may be rejected, and of one that may not.
_FEW, _MANY = 8, 200
#: The share of the allowed error that Newton's method may leave: steps are better than their estimate.
_SHARE = 0.005
#: The share that may be left in a part of a step that cannot be rejected, where updates oscillate.
_ENOUGH = 0.1
#: Inverses are reused for steps that differ by no more than this share from the step they were computed for,
_ALIKE = 0.2
#: and as long as Newton's method converges this fast.
_FAST = 0.03
#: Jacobians of more scalars run as arrays: as scalars they take seconds to compile.
_LARGEST = 2000


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class _Last:
    Z: Any  # the coordinates of its stages (s, N)
    h: Any
    contraction: Any  # how fast Newton's method converged


class _Reuse(NamedTuple):
    """The carry of adaptive steps: the last step, and inverse matrices to be reused."""

    last: _Last
    inverses: tuple[Parts, ...]  # in use
    h: jax.Array  # the step they were made for


class _SolvedStep(NamedTuple):
    """A step with solved stage equations."""

    last: _Last
    solved: jax.Array  # whether its stages solve the equations
    evaluations: Any  # a Jacobian counted as one


@dataclasses.dataclass(frozen=True)
class ImplicitRKMK(ChartMethod):
    """The implicit Runge-Kutta method of a collocation tableau in a chart, for stiff systems or symmetric integration.

    With z_i the coordinates of stage i around the start of the step, $z_i = h sum_j a_ij k_j$, k_j the slope of the
    chart at stage j, the step ends at $sum_i d_i z_i$, $d = b a^-1$. The equations are solved by Newton's method
    with the Jacobian at the start of the step, and one real and one complex inverse of the size of the tangent space.
    The initial guess extrapolates the polynomial of the previous step.

    - `tx.tableaus.RADAU_IIA5`, `RADAU_IIA9` and `RADAU_IIA3` are L-stable, also for rates up to 1e8 / h.
      They support fixed and adaptive steps.
    - `tx.tableaus.GAUSS_LEGENDRE4` and `GAUSS_LEGENDRE6` take fixed steps. Their coordinates are centred at the
      middle of the step, which makes the method symmetric. Over 1e5 steps of 0.05 s the energy of
      a heavy top stays within 1e-6 with GAUSS_LEGENDRE4; with coordinates around the start of each step the drift is
      ten times as large. Centred coordinates take about twice as many Newton iterations.

    With adaptive steps the equations are solved to a fraction of the tolerance; with fixed steps, saved times and
    derivatives to round-off, or, in a part of an adaptive step, to a tenth of the tolerance where corners of the rates
    let Newton's method oscillate. If it fails, it starts once more with updates that are accelerated by secants.
    Derivatives are those of the solution, by the implicit function theorem: forward, reverse
    and of second order. A step whose equations cannot be solved is rejected and halved; with fixed steps, or where no
    step is short enough, the integration ends with `Result.NEWTON_FAILED`.

    Attributes:
        tableau: the coefficients, a `CollocationTableau`.
        chart: the coordinates, a `tx.charts.Chart`; exponential ones in closed form by default. Fewer commutators
            than the order minus two reduce the order.

    Raises:
        ModelError: the tableau or the chart has another type; adaptive steps with a tableau whose last stage is
            not the end of the step.

    Source: Hairer, Wanner, Solving Ordinary Differential Equations II (1996), section IV.5 (Radau IIA), IV.8
    (Newton's method, the estimate of the error); Hairer, Lubich, Wanner, Geometric Numerical Integration (2006),
    sections IV.8 (charts) and V.4 (symmetric steps in charts).
    """

    tableau: CollocationTableau
    chart: Chart | None = None

    def __post_init__(self) -> None:
        wanted = "an implicit tableau like tx.tableaus.RADAU_IIA5"
        instance("ImplicitRKMK", self.tableau, CollocationTableau, wanted, ModelError)
        object.__setattr__(self, "chart", chart_of("ImplicitRKMK", self.chart, Exponential()))

    @property
    def evaluations(self) -> int:
        """Evaluations of a step with three Newton iterations."""
        return 1 + 3 * self.tableau.stages

    solves = True

    def advance(self, field: VectorField, t: jax.Array, y: Blocks, h: jax.Array) -> Blocks:
        return self.part(field, t, y, h, None)

    def part(self, field: VectorField, t: jax.Array, y: Blocks, h: jax.Array, tolerances: Tolerances | None) -> Blocks:
        equations = _StageEquations(self, field, t, y, h)
        return equations.moved(self._solution(equations, tolerances))

    def _solution(self, equations: _StageEquations, tolerances: Tolerances | None) -> jax.Array:
        """The stages, differentiable by the implicit function theorem; NaN if Newton's method fails."""

        def solve(residual: Callable[..., Any], guess: jax.Array) -> jax.Array:
            none = self._no_last_step(equations.zero)
            step = small_call(lambda last: self._to_round_off(equations, last, tolerances), none)
            return jnp.where(step.solved, step.last.Z, jnp.nan)

        def tangent_solve(linear: Callable[..., Any], b: jax.Array) -> jax.Array:
            size = b.size
            columns = jax.vmap(lambda e: linear(e.reshape(b.shape)).reshape(-1))(jnp.eye(size, dtype=b.dtype))
            return jnp.linalg.solve(columns.T, b.reshape(-1)).reshape(b.shape)

        guess = self._no_last_step(equations.zero).Z
        return jax.lax.custom_root(equations.residual, guess, solve, tangent_solve)

    def before(self, dynamics: Dynamics, y: Blocks) -> Carry:
        return self._no_last_step(self.coordinates(dynamics).packed(y, dynamics.group)[0])

    def follow(self, field: VectorField, t: jax.Array, y: Blocks, carry: Carry, h: jax.Array) -> StepAttempt:
        equations = _StageEquations(self, field, t, y, h)
        step = self._to_round_off(equations, carry)
        return StepAttempt(equations.moved(step.last.Z), step.last, (), step.evaluations, step.solved)

    #: Every step computes the rate at its start.
    resume_evaluations = 0

    def begin(self, dynamics: Dynamics, y: Blocks, rate: Blocks) -> Carry:
        last = self.before(dynamics, y)
        return _Reuse(last, Factors.none(self.tableau, last.Z[0]), jnp.zeros_like(last.h))

    def resume(self, field: VectorField, t: jax.Array, y: Blocks, carry: Carry) -> Carry:
        # With inverses from before a jump both the update and the error of a long step may come out small, as if the
        # rates after the jump were as stiff.
        return self.begin(field.dynamics, y, {})

    def attempt(
        self, field: VectorField, t: jax.Array, y: Blocks, carry: Carry, h: jax.Array, tolerances: Tolerances
    ) -> StepAttempt:
        equations = _StageEquations(self, field, t, y, h)
        eps = float(jnp.finfo(h.dtype).eps)
        rounding = 10.0 * eps / tolerances.rtol
        share = jnp.maximum(rounding, _SHARE)

        def size(dZ: jax.Array) -> jax.Array:
            return equations.error(dZ, tolerances) / share

        known: _Reuse = carry
        start = equations.first_slope()
        changed = jnp.abs(h - known.h) > _ALIKE * jnp.abs(known.h)
        renewed = changed | (known.last.contraction > _FAST)
        inverses = jax.lax.cond(
            renewed, lambda: Factors.inverses_of(self.tableau, equations.start()[1], h), lambda: known.inverses
        )
        factors = Factors(self.tableau, inverses)
        # Two updates, unless the first is zero: where stiffness falls within the step, inverses from its start make any
        # update small, and only a second one of the same size shows it.
        last = dataclasses.replace(known.last, contraction=jnp.ones_like(h) / eps)
        step = self._solved(equations, (start, inverses), factors, size, last, _FEW, rounding / share)
        learned = _Reuse(step.last, inverses, jnp.where(renewed, h, known.h))
        raw = self.tableau.start_weight * h * start + combined([self.tableau.error_weights], list(step.last.Z))[0]
        errors = (equations.read(factors.damped(raw)),)
        evaluations = step.evaluations + renewed.astype(step.evaluations.dtype)
        return StepAttempt(equations.moved(step.last.Z), learned, errors, evaluations, step.solved)

    def _no_last_step(self, zero: jax.Array) -> _Last:
        """The carry before the first step, in place of a last step."""
        none = jnp.zeros((), zero.dtype)
        return _Last(jnp.zeros((self.tableau.stages, zero.size), zero.dtype), none, none + 1.0)

    def _guess(self, last: _Last, h: jax.Array) -> jax.Array:
        """The stages by extrapolation of the polynomial of the last step."""
        known = last.h != 0.0
        ratio = jnp.where(known, h / jnp.where(known, last.h, 1.0), 0.0)
        powers = combined(self.tableau.polynomial, list(last.Z))
        end = sum(powers)

        def at(x: jax.Array) -> jax.Array:
            value = powers[-1]
            for power in reversed(powers[:-1]):
                value = power + x * value
            return x * value - end

        return jnp.where(known, jnp.stack([at(1.0 + float(c) * ratio) for c in self.tableau.c]), 0.0)

    def _solved(
        self,
        equations: _StageEquations,
        start_values: Any,
        factors: Factors,
        size: Any,
        last: _Last,
        most: int,
        rounding: Any,
        **options: Any,
    ) -> _SolvedStep:
        """The stages by Newton's method, until the scaled correction is below 1."""
        guess = self._guess(last, equations.h)
        # A step that cannot be rejected gets a second guess.
        again = most == _MANY
        solved = newton(
            lambda Z: factors.solve(equations.residual(Z)),
            size,
            guess,
            last.contraction,
            most,
            again,
            rounding,
            **options,
        )
        evaluations = 1 + self.tableau.stages * solved.iterations
        # Rates that are NaN at the start are no failure of the equations.
        good = solved.done | ~all_finite(start_values)
        return _SolvedStep(_Last(solved.Z, equations.h, solved.contraction), good, evaluations)

    def _to_round_off(
        self, equations: _StageEquations, last: _Last, tolerances: Tolerances | None = None
    ) -> _SolvedStep:
        """The stages, solved to round-off; where rates have corners, at least to the share of the tolerances that steps
        are solved to.
        """
        local, read, y, h = equations.local, equations.read, equations.y, equations.h
        start, J = equations.start()
        factors = Factors(self.tableau, Factors.inverses_of(self.tableau, J, h))

        def deviation(z: jax.Array) -> jax.Array:
            return ravel_pytree(local.deviation(read(z), y))[0]

        # The effect of rounding of the state on rates, in the equations.
        D = jnp.abs(jax.jacfwd(deviation)(equations.zero))
        state_sizes = ravel_pytree(local.sizes(y, y))[0]
        rounding = jnp.sum(jnp.abs(h * J) * jnp.sum(D * state_sizes[:, None], axis=0)[None, :], axis=1) + jnp.abs(
            h * start
        )
        sizes = state_sizes + jnp.sum(D * factors.reach(rounding)[None, :], axis=1)
        unit = float(jnp.finfo(h.dtype).eps) * jnp.maximum(sizes, float(jnp.finfo(h.dtype).tiny) * 1e20)

        def size(dZ: jax.Array) -> jax.Array:
            return jnp.sqrt(jnp.mean(jnp.square(jax.vmap(deviation)(dZ) / unit[None, :])))

        options: dict[str, Any] = {}
        if tolerances is not None:
            options["enough"] = lambda dZ: equations.error(dZ, tolerances) < _ENOUGH
        return self._solved(equations, (start, J), factors, size, last, _MANY, 1.0, **options)


class _StageEquations:
    """Z = h (a x I) K(Z) for the packed coordinates Z (s, N) of the stages of a step of length h from (t, y).

    With w_i = z_i the state of stage i is move(y, w_i), and its slope k_i that of the chart there. For a symmetric
    tableau coordinates are around the middle of the step instead: with D = sum_i d_i z_i and m = move(y, D/2) the state
    of stage i is move(m, w_i), w_i = z_i - D/2. Then the step of -h from the end leads back to the start.

    Source for the middle: Hairer, Lubich, Wanner, Geometric Numerical Integration (2006), section V.4.
    """

    def __init__(self, method: ImplicitRKMK, field: VectorField, t: jax.Array, y: Blocks, h: jax.Array) -> None:
        self.tableau, self.local, self.field = method.tableau, method.coordinates(field.dynamics), field
        self.t, self.y, self.h = t, y, h
        self.zero, self.read = self.local.packed(y, field.dynamics.group)

    def error(self, dZ: jax.Array, tolerances: Tolerances) -> jax.Array:
        """The root mean square of a difference of stages in units of the allowed error."""
        y, read = self.y, self.read
        squares = jax.vmap(lambda dz: tolerances.mean_square(self.local, read(dz), y, y))(dZ)
        return jnp.sqrt(jnp.mean(squares))

    def moved(self, Z: jax.Array) -> Blocks:
        """The stored state at the end of the step."""
        return self.local.settle(self.local.move(self.y, self.read(self._end(Z))))

    def _end(self, Z: jax.Array) -> jax.Array:
        return combined([self.tableau.end], list(Z))[0]

    def slopes(self, Z: jax.Array) -> jax.Array:
        """K(Z), one stage a row."""
        base = self.y
        if self.tableau.symmetric:
            half = 0.5 * self._end(Z)
            base, Z = self.local.move(self.y, self.read(half)), Z - half[None, :]
        nodes = jnp.asarray(self.tableau.c, self.h.dtype)
        # In a loop: from a table XLA would compute a whole slope for every entry.
        return jax.lax.map(lambda entry: self._slope(self.t + entry[0] * self.h, base, entry[1]), (nodes, Z))

    def start(self) -> tuple[jax.Array, jax.Array]:
        """The slope at the start of the step (N,), and its derivative with respect to the coordinates (N, N)."""

        def along(direction: jax.Array) -> tuple[jax.Array, jax.Array]:
            return jax.jvp(lambda z: self._slope(self.t, self.y, z), (self.zero,), (direction,))

        eye = jnp.eye(self.zero.size, dtype=self.zero.dtype)
        of, values = opened(jax.make_jaxpr(lambda: list(jax.vmap(along, out_axes=(None, 1))(eye)))())
        # Scalars omit zeros and entries that are equal in many columns.
        slope, jacobian = XLA(least=0, largest=_LARGEST).emit(jax.make_jaxpr(of)(*values)).function(*values)
        return slope, jacobian

    def first_slope(self) -> jax.Array:
        """The slope at the start of the step (N,)."""
        return self._slope(self.t, self.y, self.zero)

    def residual(self, Z: jax.Array) -> jax.Array:
        """a^-1 Z - h K(Z)."""
        return jnp.stack(combined(self.tableau.inverse, list(Z))) - self.h * self.slopes(Z)

    def _slope(self, time: jax.Array, base: Blocks, z: jax.Array) -> jax.Array:
        coordinates = self.read(z)
        moved = self.local.move(base, coordinates)
        rate = self.local.rate(self.field(time, self.local.value(moved)))
        return ravel_pytree(self.local.slope(coordinates, moved, rate))[0]
