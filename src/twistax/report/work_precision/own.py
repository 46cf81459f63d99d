"""Our methods as contenders: `tx.integrate` inside one jitted function of the start."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

import twistax as tx

from ...integrators import Method
from ...integrators.step_control import StepControl
from ...scenes import Scene
from .contender import Contender, Counts, Effort, Ladder, Line, Program

__all__ = ["Adaptive", "FixedSteps"]

#: The default in all but the most steps there may be.
_CONTROL = StepControl(max_steps=10**7)


@dataclasses.dataclass(frozen=True)
class Adaptive(Contender):
    """A method that chooses its steps; the setting is rtol = atol."""

    name: str
    line: Line
    method: Method

    def ladder(self, effort: Effort) -> Ladder:
        return effort.tolerances

    def build(self, scene: Scene) -> Program:
        def solve(start: Any, tolerance: jax.Array) -> tuple[Any, Counts]:
            return _solved(scene, start, self.method, rtol=tolerance, atol=tolerance, control=_CONTROL)

        return _program(scene, self.method, solve, one_for_all=True)


@dataclasses.dataclass(frozen=True)
class FixedSteps(Contender):
    """A method with equal steps; the setting is their number."""

    name: str
    line: Line
    method: Method

    def ladder(self, effort: Effort) -> Ladder:
        return effort.steps

    def build(self, scene: Scene) -> Program:
        def solve(start: Any, steps: float) -> tuple[Any, Counts]:
            return _solved(scene, start, self.method, steps=int(steps))

        return _program(scene, self.method, solve, one_for_all=False)


def _program(scene: Scene, method: Method, solve: Any, one_for_all: bool) -> Program:
    """A function of one flat array, as diffrax has it: each array in or out costs JAX about a microsecond a call."""
    method.check(scene.dynamics)
    start, read = ravel_pytree({name: jnp.asarray(value) for name, value in scene.start.items()})

    def flat(start: jax.Array, setting: Any) -> tuple[jax.Array, Counts]:
        end, counts = solve(read(start), setting)
        return ravel_pytree(end)[0], counts

    return Program(start, flat, read, one_for_all)


def _solved(scene: Scene, start: Any, method: Method, **steps: Any) -> tuple[Any, Counts]:
    sol = tx.integrate(
        scene.dynamics,
        start,
        t1=scene.duration,
        method=method,
        u=scene.u,
        params=scene.params,
        throw=False,
        **steps,
    )
    end = {name: value[0] for name, value in sol.xs.items()}
    stats, good = sol.stats, sol.result == tx.Result.SUCCESS
    return end, Counts(*map(jnp.asarray, (stats.accepted, stats.rejected, stats.rhs_evaluations, good)))
