"""Runge-Kutta-Munthe-Kaas: a Runge-Kutta method in coordinates around the start of each step."""

from __future__ import annotations

import dataclasses

import jax
from jax.flatten_util import ravel_pytree

from ..errors import ModelError
from ..lowering import Dynamics
from ..lowering.dynamics import Arrays
from .charts import Chart, Exponential, chart_of
from .charts.whole import Blocks, StateCoordinates, coordinates_of
from .held import held
from .method import Attempt, Carry, ControlsAt, Method
from .stages import stage_slopes
from .tableau import ButcherTableau
from .tolerances import Tolerances

__all__ = ["RKMK"]


@dataclasses.dataclass(frozen=True)
class RKMK(Method):
    """The explicit Runge-Kutta-Munthe-Kaas method of a tableau in a chart.

    On states without a group it is the Runge-Kutta method. Methods are values: they are equal where tableaus and charts
    are.

    Attributes:
        tableau: the coefficients.
        chart: the coordinates around the start of a step, a `tx.charts.Chart`; exponential coordinates with as many
            commutators as the order needs if left out.

    Raises:
        ModelError: no tableau, or no chart.

    Source: Munthe-Kaas, High order Runge-Kutta methods on manifolds (1999); Iserles, Munthe-Kaas, Norsett, Zanna,
    Lie-group methods (2000), both for right-trivialised equations, where the Jacobian is the left one.
    """

    tableau: ButcherTableau
    chart: Chart | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.tableau, ButcherTableau):
            raise ModelError(f"RKMK expects a tableau like tx.tableaus.RK4, got {self.tableau!r}")
        default = Exponential(commutators=max(1, self.tableau.order - 2))
        object.__setattr__(self, "chart", chart_of("RKMK", self.chart, default))

    @property
    def name(self) -> str:
        return f"{self.tableau.name}, {self.chart!r}"

    @property
    def order(self) -> int:
        return self.tableau.order

    @property
    def evaluations(self) -> int:
        return self.tableau.counted_stages

    def coordinates(self, dynamics: Dynamics) -> StateCoordinates:
        return coordinates_of(self.chart, dynamics.group)

    @property
    def error_order(self) -> int:
        return self.tableau.error_order

    def advance(
        self, dynamics: Dynamics, t: jax.Array, y: Blocks, u_at: ControlsAt, params: Arrays, h: jax.Array
    ) -> Blocks:
        """The stored state after one step of length h. Pure and traceable.

        Rounding takes rotations out of their group, linearly in the number of steps where the twist is constant;
        settling once a step keeps them at round-off.
        """
        local = self.coordinates(dynamics)

        def slope(time: jax.Array, z: Blocks) -> tuple[Blocks, None]:
            moved = held(local.move(y, z))
            return local.slope(z, moved, held(self.rate(dynamics, time, moved, u_at, params))), None

        first = local.first_slope(y, self.rate(dynamics, t, y, u_at, params))
        slopes, _ = stage_slopes(self.tableau.counted, slope, first, None, t, h)
        return local.settle(local.move(y, slopes.combine(self.tableau.b, h)))

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
        """A step whose last stage is its end, so that the rate there, which it carries, serves the next step too."""
        local = self.coordinates(dynamics)
        (start, read_state), (packed, read_rate) = ravel_pytree(y), ravel_pytree(carry)

        def slope(time: jax.Array, z: Blocks) -> tuple[Blocks, tuple[jax.Array, jax.Array]]:
            moved = held(local.move(y, z))
            rate = held(self.rate(dynamics, time, moved, u_at, params))
            # Packed: the loop would carry every scalar by itself.
            return local.slope(z, moved, rate), (ravel_pytree(moved)[0], ravel_pytree(rate)[0])

        tableau = self.tableau
        stages = tableau.to_the_end
        slopes, (moved, rate) = stage_slopes(stages, slope, local.first_slope(y, carry), (start, packed), t, h)
        embedded = [w for w in (tableau.b_embedded, tableau.b_second_embedded) if w is not None]
        errors = tuple(slopes.combine(tableau.b - weights, h) for weights in embedded)
        return Attempt(local.settle(read_state(moved)), read_rate(rate), errors, len(stages.c) - 1)

    def increment(
        self, dynamics: Dynamics, t: jax.Array, x: Arrays, u_at: ControlsAt, params: Arrays, h: jax.Array
    ) -> Arrays:
        """The tangent eta of one step, so that the step ends at x (+) eta = x Exp(eta).

        With Omega(t, x) the body velocities of all states, stage i stands at x Exp(eta_i) and

            eta_i = h sum_j a_ij k_j,   k_i = J_r(eta_i)^-1 Omega(t + c_i h, x Exp(eta_i)),   eta = h sum_i b_i k_i,

        because eta' = J_r(eta)^-1 Omega for g = g_0 Exp(eta) and g' = g Omega^, with J_r the right Jacobian, cut after
        the chart's commutators. It is the step of `advance` on the values themselves, for derivatives.

        Args:
            u_at: the prepared controls at a stage time.
            h: the length of the step in s.
        Returns:
            name -> tangent (dimension of the state,), of states without a group read row by row.
        Raises:
            ModelError: a chart whose coordinates are no tangents.
        """
        local, factors = self.coordinates(dynamics), dynamics.group.factors

        def omega(time: jax.Array, point: Arrays) -> Blocks:
            return local.rate(dynamics._functions.vector_field(time, point, u_at(time), params))

        def slope(time: jax.Array, z: Blocks) -> tuple[Blocks, None]:
            eta = local.tangent(z)
            point = {name: group.retract(x[name], eta[name]) for name, group in factors.items()}
            return local.slope(z, z, omega(time, point)), None

        # At the start of a step exponential coordinates change as the body velocity does.
        slopes, _ = stage_slopes(self.tableau.counted, slope, omega(t, x), None, t, h)
        return local.tangent(slopes.combine(self.tableau.b, h))
