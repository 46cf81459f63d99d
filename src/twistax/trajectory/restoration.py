"""The search for feasible points where no step is: how far it goes, and how it ends."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from . import feasibility
from .decisions import RENEW
from .interior_point import InteriorPoint
from .iterate import State
from .steps import Steps
from .transcribed import Given, jitted
from .watch import Status

#: A feasible point is worth leaving the search for if it leaves so much of the violation and the filter does not know
#: better, or if it leaves so little.
_WORTH, _LITTLE = 0.5, 0.1
#: Relative slope of a stationary point, and its damping.
_FLAT, _MOST_DAMPING = 1e-7, 1e12
#: A search creeps where so many steps leave more than this share of the sum of squares.
_CREEPING = 30, 0.9
#: The least slack after a search, scaled.
_SLACK = 1e-3


class Restoration:
    """Searches for feasible points of one problem; what it needs compiles once."""

    def __init__(self, method: InteriorPoint, steps: Steps, tolerance: float) -> None:
        self._method, self._steps, self._tolerance = method, steps, tolerance
        self._begin = jitted(lambda state: feasibility.begin(method, state), 0)
        self._reduce = jitted(lambda *args: feasibility.reduce(method, *args))
        self._judged = jitted(self._judge, 0)

    def violation(self, state: State) -> float:
        """The largest at a state, scaled."""
        return float(self._begin(state).largest)

    def found(self, state: State, given: Given, budget: int, hasty: bool = False) -> tuple[State, int, Status | None]:
        """A point that violates less; how many steps it took; INFEASIBLE or STALLED if no step helps.

        INFEASIBLE where the violation has no slope, in scales of that point; STALLED where it has, but no step helps.

        Args:
            hasty: STALLED where the search creeps, too.
        """
        search = self._begin(state)
        theta, _, _ = self._judged(state, search)
        count, rest, in_scale, before = 0, None, False, np.inf
        while count < budget:
            slopes, _ = self._steps.looked_at(feasibility.at(search, state), given)
            search = self._reduce(search, state, slopes, given)
            count += 1
            reached, known, _ = self._judged(state, search)
            if float(search.largest) <= 0.1 * self._tolerance:
                break
            if float(reached) <= (_LITTLE if bool(known) else _WORTH) * float(theta):
                break
            flat = float(search.slope) <= _FLAT * float(search.size) ** 0.5
            if flat and not in_scale:  # a slope may be small in scales that are far off
                in_scale, before = True, np.inf
                fresh, change = self._steps.scales(search.point, slopes, state.scales)
                if float(change) > RENEW:
                    state = self._steps.rescaled(state._replace(point=search.point, values=search.values), fresh)
                    search = self._begin(state)
                    theta = self._judged(state, search)[0]
                    continue
            if flat or float(search.damping) > _MOST_DAMPING:
                if float(search.largest) > self._tolerance:
                    rest = Status.INFEASIBLE if flat else Status.STALLED
                break
            if hasty and count % _CREEPING[0] == 0:
                if float(search.size) > _CREEPING[1] * before:
                    rest = Status.STALLED
                    break
                before = float(search.size)
        _, _, slack = self._judged(state, search)
        rows = jnp.where(self._method.inequality, state.barrier / slack, 0.0)
        state = state._replace(
            point=search.point,
            values=search.values,
            slack=slack,
            dynamics=jnp.zeros_like(state.dynamics),
            rows=rows,
            filter=jnp.full_like(state.filter, jnp.inf),
            filtered=jnp.zeros_like(state.filtered),
            stuck=jnp.zeros_like(state.stuck),
        )
        return state, count, rest

    def _judge(self, state: State, search: feasibility.Search) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Violation, whether the filter knows better, and slacks of a feasible point."""
        method = self._method
        values = method.scaled(search.values, state.scales)
        slack = jnp.where(method.inequality, jnp.maximum(-values.rows, _SLACK), 1.0)
        theta, phi = method.theta(values, slack), method.phi(values, slack, state.barrier)
        known = ((theta >= state.filter[0]) & (phi >= state.filter[1])).any()
        return theta, known, slack
