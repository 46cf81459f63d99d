"""Whether a system is free motion and kicks: found by derivatives at random states."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from ...errors import ModelError
from ...expr import Parameter
from ...lowering import Dynamics
from ...lowering.dynamics import Arrays
from .motion import FreeMotion

__all__ = ["check_motions"]

#: Random states to look at.
_DRAWS = 3

_OTHERWISE = "tx.RKMK(tableau) takes every system"


def check_motions(dynamics: Dynamics, motions: Sequence[FreeMotion]) -> None:
    """Hold a system against the free motions of its parts.

    Rates that are free motion and kicks have three marks, and these are looked at where states are random numbers: the
    rates of positions are those of the free motion; the derivatives of the rates of velocities with respect to all
    velocities are those of the free motion, and vanish at rest; parameters that the free motion does not read do not
    change them. Derivatives, because differences of rates would drown in large forces.

    Raises:
        ModelError: names the state, and what is different.
    """
    _check_states(dynamics, motions)
    for motion in motions:
        motion.check(dynamics)
    rng = np.random.default_rng(5)
    with jax.ensure_compile_time_eval():
        compare = jax.jit(_Comparison(dynamics, motions))
        for _ in range(_DRAWS):
            found = jax.device_get(compare(*_drawn(dynamics, motions, rng)))
            for motion in motions:
                _judge(motion, found)


def _check_states(dynamics: Dynamics, motions: Sequence[FreeMotion]) -> None:
    covered = [name for motion in motions for name in (motion.position, motion.velocity)]
    known = [state.name for state in dynamics.states]
    for name in covered:
        if name not in known:
            raise ModelError(f"Splitting: {name!r} is no state of the system; it has: {', '.join(map(repr, known))}")
        if covered.count(name) > 1:
            raise ModelError(f"Splitting: state {name!r} belongs to two parts of {list(motions)!r}")
    missing = [name for name in known if name not in covered]
    if missing:
        raise ModelError(
            f"Splitting: no body covers state {missing[0]!r}.\n"
            "  fix: add a tx.FreeBody or a tx.FreeParticle to bodies; "
            f"a state that is no position or velocity has no free motion, but {_OTHERWISE}"
        )


class _Comparison:
    """What is compared at one point, by the name of the state; traceable."""

    def __init__(self, dynamics: Dynamics, motions: Sequence[FreeMotion]) -> None:
        self.dynamics, self.motions = dynamics, motions
        self.read = {name for motion in motions for name in motion.parameters}

    def __call__(self, t: jax.Array, d: Arrays, u: Arrays, params: Arrays, direction: Arrays) -> dict[str, Any]:
        """At the state Exp(d), the parameters moved in a direction."""
        x = {name: group.exp(d[name].reshape(-1)) for name, group in self.dynamics.group.factors.items()}
        names = [motion.velocity for motion in self.motions]
        velocities = {name: x[name] for name in names}

        def system(velocities: Arrays, params: Arrays) -> Arrays:
            return self.dynamics._functions.vector_field(t, x | velocities, u, params)

        def free(velocities: Arrays, params: Arrays) -> Arrays:
            rates: Arrays = {}
            for motion in self.motions:
                rates |= motion.rates(self.dynamics, x | velocities, params)
            return rates

        def slopes(rates: Any, velocities: Arrays, params: Arrays) -> Arrays:
            """The derivatives of the rates of velocities by all velocities, a matrix each."""
            flat, read = ravel_pytree(velocities)
            found = jax.jacfwd(lambda z: {n: rates(read(z), params)[n].reshape(-1) for n in names})(flat)
            return dict(found)

        moved = {n: d if n not in self.read else jnp.zeros_like(d) for n, d in direction.items()}
        change = jax.jvp(lambda p: slopes(system, velocities, p), (params,), (moved,))[1] if params else {}
        at_rest = {name: jnp.zeros_like(value) for name, value in velocities.items()}
        return {
            "system": slopes(system, velocities, params),
            "free": slopes(free, velocities, params),
            "rest": slopes(system, at_rest, params),
            "change": change,
            "position": (system(velocities, params), free(velocities, params)),
        }


def _judge(motion: FreeMotion, found: dict[str, Any]) -> None:
    position, velocity = motion.position, motion.velocity
    ours, theirs = (rates[position] for rates in found["position"])
    tolerance = float(np.sqrt(np.finfo(theirs.dtype).eps))
    if not np.abs(ours - theirs).max() <= tolerance * np.abs(theirs).max():
        raise ModelError(
            f"Splitting: the rate of {position!r} is not the velocity of {motion!r}.\n"
            f"  fix: for a FreeBody it is the body velocity, or J^-1 or M^-1 times the body momentum; {_OTHERWISE}"
        )
    system, free, rest = (found[kind][velocity] for kind in ("system", "free", "rest"))
    size = max(np.abs(free).max(), np.abs(system).max())
    if not np.isfinite(size):
        raise ModelError(
            f"Splitting: the rate of {velocity!r} is not finite at random states, so it cannot be checked.\n"
            f"  fix: {_OTHERWISE}"
        )
    if np.abs(rest).max() > tolerance**1.5 * size:
        raise ModelError(
            f"Splitting: the rate of {velocity!r} depends on velocities also near rest: drag, damping, a gyroscopic or "
            f"Coriolis force. Splitting needs forces that depend on poses and time alone.\n  fix: {_OTHERWISE}"
        )
    off = np.abs(system - free).max()
    if off > tolerance * size:
        raise ModelError(
            f"Splitting: the rate of {velocity!r} depends on velocities in another way than that of {motion!r} in free "
            f"motion (relative difference {off / size:.1e}): another inertia, or a force that depends on velocities.\n"
            f"  fix: give the inertia of the system, in its axes; {_OTHERWISE}"
        )
    if found["change"] and np.abs(found["change"][velocity]).max() > tolerance * size:
        raise ModelError(
            f"Splitting: the inertia of {motion!r} depends on parameters of the system that it does not name.\n"
            "  fix: give inertia as the Parameter, its name, or an expression of parameters; or fold them into the "
            "system: tx.compile(system, bake={...})"
        )


def _drawn(dynamics: Dynamics, motions: Sequence[FreeMotion], rng: np.random.Generator) -> tuple[Any, ...]:
    """A time, tangents of states, controls, parameters, and a direction to move the parameters in."""
    dtype = jax.dtypes.canonicalize_dtype(float)

    def cast(values: dict[str, Any]) -> Arrays:
        return {name: jnp.asarray(value, dtype) for name, value in values.items()}

    d = {
        state.name: rng.normal(size=state.group.dimension) * np.ravel(1.0 if state.scale is None else state.scale)
        for state in dynamics.states
    }
    u = {control.name: rng.normal(size=control.shape) for control in dynamics.controls}
    params = {parameter.name: _parameter(parameter, rng) for parameter in dynamics.parameters}
    direction = {
        name: np.where(value == 0.0, 1.0, value) * rng.normal(size=value.shape) for name, value in params.items()
    }
    return jnp.asarray(rng.uniform(0.0, 2.0), dtype), cast(d), cast(u), cast(params), cast(direction)


def _parameter(parameter: Parameter, rng: np.random.Generator) -> np.ndarray:
    """A value near the parameter's own, of the same form; where it has none, one that a real body may have."""
    share = rng.uniform(0.8, 1.2)
    if parameter.value is not None:
        return np.asarray(share * parameter.value)
    if parameter.shape == (3, 3):
        arm = rng.normal(size=(3, 3))
        return np.eye(3) + 0.1 * (arm @ arm.T)
    if parameter.shape == (6, 6):
        return np.diag([share, share, share, *rng.uniform(1.0, 2.0, size=3)])
    if parameter.shape == (6,):
        return np.array([share, share, share, *rng.uniform(1.0, 2.0, size=3)])
    return np.asarray(rng.uniform(1.0, 2.0, size=parameter.shape))
