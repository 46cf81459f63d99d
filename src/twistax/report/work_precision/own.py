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

__all__ = ["Adaptive", "EqualSteps"]

#: The default in all but the most steps there may be.
_CONTROL = StepControl(max_steps=10**7)


@dataclasses.dataclass(frozen=True)
class _Own(Contender):
    name: str
    line: Line
    method: Method

    def build(self, scene: Scene) -> Program:
        """A function of one flat array, as diffrax has it: each array in or out costs JAX a microsecond a call."""
        self.method.check(scene.dynamics)
        start, read = ravel_pytree({name: jnp.asarray(value) for name, value in scene.start.items()})

        def solve(start: jax.Array, setting: Any) -> tuple[jax.Array, Counts]:
            end, counts = _solved(scene, read(start), self.method, **self.steps(setting))
            return ravel_pytree(end)[0], counts

        return Program(start, solve, read, isinstance(self, Adaptive))

    def steps(self, setting: Any) -> dict[str, Any]:
        """How `tx.integrate` is told the setting."""
        raise NotImplementedError


class Adaptive(_Own):
    """A method that chooses its steps; the setting is rtol = atol."""

    def ladder(self, effort: Effort) -> Ladder:
        return effort.tolerances

    def steps(self, setting: Any) -> dict[str, Any]:
        return {"rtol": setting, "atol": setting, "control": _CONTROL}


class EqualSteps(_Own):
    """A method with equal steps; the setting is their number."""

    def ladder(self, effort: Effort) -> Ladder:
        return effort.steps

    def steps(self, setting: Any) -> dict[str, Any]:
        return {"steps": int(setting)}


def _solved(scene: Scene, start: Any, method: Method, **steps: Any) -> tuple[Any, Counts]:
    given: dict[str, Any] = {"u": scene.u, "params": scene.params, "method": method, "throw": False}
    sol = tx.integrate(scene.dynamics, start, t1=scene.duration, **given, **steps)
    end = {name: value[0] for name, value in sol.xs.items()}
    stats, good = sol.stats, sol.result == tx.Result.SUCCESS
    return end, Counts(*map(jnp.asarray, (stats.accepted, stats.rejected, stats.rhs_evaluations, good)))
