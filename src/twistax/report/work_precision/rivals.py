"""diffrax on the same system as an ordinary differential equation in quaternions, as shipped and in one small call."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

import twistax as tx

from ...lowering.small_call import fits, small_call
from ...scenes import Scene
from .contender import Contender, Counts, Effort, Ladder, Line, Program

__all__ = ["AsShipped", "Diffrax", "DiffraxImplicit", "Gains", "I_CONTROL", "OneSmallCall", "PI_CONTROL"]

Solve = Callable[[Any, Any], tuple[Any, Counts]]

#: More steps than any run here takes; diffrax's own limit is 4096.
_MOST_STEPS = 10**7


@dataclasses.dataclass(frozen=True)
class Gains:
    """Of diffrax's PIDController."""

    pcoeff: float
    icoeff: float


#: diffrax's default, and proportional-integral control, which rejects fewer steps on some scenes.
I_CONTROL, PI_CONTROL = Gains(0.0, 1.0), Gains(0.4, 0.3)


class AsShipped:
    """How diffrax's solve becomes a program: `jax.jit` around `diffeqsolve` with its defaults."""

    @property
    def options(self) -> dict[str, Any]:
        """Further arguments of `diffeqsolve`."""
        return {}

    def wrap(self, solve: Solve) -> Solve:
        """What is jitted."""
        return solve


class OneSmallCall(AsShipped):
    """The whole solve compiled as one small function, as our own integrations are.

    Without diffrax's error check, a callback, which does not compile that way, and with ForwardMode, the cheapest
    way to plain numbers.
    """

    @property
    def options(self) -> dict[str, Any]:
        import diffrax

        return {"throw": False, "adjoint": diffrax.ForwardMode()}

    def wrap(self, solve: Solve) -> Solve:
        # diffrax's loops are built on operations of equinox, all of which compile inside of one function.
        return lambda start, tolerance: small_call(solve, start, tolerance, trusted=True)


@dataclasses.dataclass(frozen=True)
class Diffrax(Contender):
    """A solver of diffrax with PIDController, the first step chosen by it, rtol = atol = the setting.

    The state is one flat vector, which diffrax runs faster than a dict.

    Attributes:
        solver: name of its class in diffrax; a first-same-as-last Runge-Kutta method.
        gains: of the controller.
        form: how it is compiled.
    """

    name: str
    line: Line
    solver: str
    gains: Gains
    form: AsShipped

    #: Of a run.
    most_steps: ClassVar[int] = _MOST_STEPS

    def ladder(self, effort: Effort) -> Ladder:
        return effort.tolerances

    def build(self, scene: Scene) -> Program:
        import diffrax

        term = tx.diffrax.ambient_term(scene.dynamics)
        start, unravel = ravel_pytree(term.to_ambient(scene.start))
        u, params = scene.u, {name: jnp.asarray(value) for name, value in scene.params.items()}
        solver = getattr(diffrax, self.solver)()

        def rate(t: Any, y: jax.Array, args: Any) -> jax.Array:
            return ravel_pytree(term.vector_field(t, unravel(y), (u, params)))[0]

        if not fits(lambda y: rate(jnp.zeros(()), y, None), start):
            raise tx.ModelError(f"the right-hand side of {scene.name} calls a library: no small call")

        def solve(y: jax.Array, tolerance: jax.Array) -> tuple[Any, Counts]:
            control = diffrax.PIDController(tolerance, tolerance, **dataclasses.asdict(self.gains))
            options = {"stepsize_controller": control, "max_steps": self.most_steps} | self.form.options
            sol = diffrax.diffeqsolve(diffrax.ODETerm(rate), solver, 0.0, scene.duration, None, y, **options)
            accepted, rejected = sol.stats["num_accepted_steps"], sol.stats["num_rejected_steps"]
            evaluations = self.evaluations(solver, accepted + rejected)
            return sol.ys[0], Counts(accepted, rejected, evaluations, jnp.isfinite(sol.ys[0]).all())

        return Program(start, self.form.wrap(solve), lambda y: term.from_ambient(unravel(y)), one_for_all=True)

    def evaluations(self, solver: Any, steps: jax.Array) -> jax.Array:
        """How often the right-hand side was evaluated."""
        # The last stage of a step is the first of the next; the choice of the first step is left out.
        return (solver.tableau.num_stages - 1) * steps + 1


@dataclasses.dataclass(frozen=True)
class DiffraxImplicit(Diffrax):
    """An implicit solver, which does not say how often it evaluates the right-hand side: 0."""

    #: Near round-off its steps may become so short that a run takes hours.
    most_steps: ClassVar[int] = 20_000

    def evaluations(self, solver: Any, steps: jax.Array) -> jax.Array:
        return jnp.zeros_like(steps)
