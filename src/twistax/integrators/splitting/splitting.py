"""Splitting methods, which alternate free motion and kicks; and the check whether a system has that form."""

from __future__ import annotations

import dataclasses
import weakref
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from ...checks import instance
from ...errors import ModelError
from ...expr import Parameter
from ...system.dynamics import Arrays, Dynamics
from ..charts.coordinates import Blocks, StoredState
from ..method import Method, VectorField
from .body import Flows, FreeMotion
from .compositions import Composition

#: What was found to fit: parts by system.
_CHECKED: weakref.WeakKeyDictionary[Dynamics, set[tuple[FreeMotion, ...]]] = weakref.WeakKeyDictionary()


class _AllParts(StoredState):
    """The flows of all parts, which have no states in common."""

    def __init__(self, parts: Sequence[Flows]) -> None:
        self.parts = parts

    def enter(self, x: Arrays) -> Blocks:
        return {name: block for part in self.parts for name, block in part.enter(x).items()}

    def value(self, y: Blocks) -> Arrays:
        return {name: value for part in self.parts for name, value in part.value(y).items()}


@dataclasses.dataclass(frozen=True)
class Splitting(Method):
    """A splitting method for bodies in a potential: explicit, reversible and symplectic, for long integrations.

    Forces and torques may depend on poses, time, controls and parameters, but not on velocities. Let S be the exact
    free motion of bodies with an axis of symmetry, r_1, r_2, ... rotations by the remaining parts of the kinetic
    energy, and K the change of momenta by all forces. A step of length h is composed of the symmetric steps

        S(h/2) r_1(h/2) r_2(h/2) ... K(h) ... r_2(h/2) r_1(h/2) S(h/2),

    where neighbouring S are combined, so each stage takes one evaluation of the rates, and the ends of a step take
        none.
    The rates at rest are the forces, so any compiled system of this form is supported; others raise an error. Between
    steps momenta are stored in world axes: a momentum that no force changes is conserved exactly. Energy errors stay
    bounded if steps resolve the motion. Steps are fixed.

    Attributes:
        composition: a `tx.compositions.Composition`, such as `tx.compositions.KAHAN_LI8`.
        bodies: a `tx.FreeBody` or `tx.FreeParticle`, or several, which together have all states of the system.

    Raises:
        ModelError: the composition or the bodies have another type. When integrated: states that belong to no body;
            forces that depend on velocities; an inertia that differs from that of the system.

    Source: Hairer, Lubich, Wanner, Geometric Numerical Integration (2006), sections II.5 and V.3 (splitting and
    composition) and VII.5 (rigid bodies).
    """

    composition: Composition
    bodies: Any

    def __post_init__(self) -> None:
        wanted = "a composition like tx.compositions.KAHAN_LI8"
        instance("Splitting", self.composition, Composition, wanted, ModelError)
        bodies = (self.bodies,) if isinstance(self.bodies, FreeMotion) else self.bodies
        if not isinstance(bodies, (tuple, list)) or not bodies or not all(isinstance(b, FreeMotion) for b in bodies):
            raise ModelError(
                f"Splitting expects bodies like tx.FreeBody('R', 'w', inertia=...), one or a list, got {self.bodies!r}"
            )
        object.__setattr__(self, "bodies", tuple(bodies))

    @property
    def name(self) -> str:
        return f"{self.composition.name} splitting"

    @property
    def order(self) -> int:
        return self.composition.order

    @property
    def evaluations(self) -> int:
        return self.composition.stages

    def check(self, dynamics: Dynamics) -> None:
        """Raise ModelError, with the reason, for a system whose forces depend on velocities and for a wrong inertia.

        The check uses derivatives at random states, once for a system and its bodies.
        """
        known = _CHECKED.setdefault(dynamics, set())
        if self.bodies not in known:
            _check(dynamics, self.bodies)
            known.add(self.bodies)

    def stored(self, dynamics: Dynamics, params: Arrays) -> _AllParts:
        return _AllParts([body.flows(dynamics, params) for body in self.bodies])

    def advance(self, field: VectorField, t: jax.Array, y: Blocks, h: jax.Array) -> Blocks:
        parts = self.stored(field.dynamics, field.params).parts

        def stage(y: Blocks, entry: tuple[jax.Array, ...]) -> tuple[Blocks, None]:
            weight, node, further = entry
            for part in parts:
                y = part.inner(y, 0.5 * weight * h, backwards=False)
            rates = field(t + node * h, {name: x for part in parts for name, x in part.at_rest(y).items()})
            for part in parts:
                y = part.kick(y, rates, weight * h)
                y = part.inner(y, 0.5 * weight * h, backwards=True)
                y = part.settle(part.outer(y, further * h))
            return y, None

        first, *_ = between = self.composition.between
        for part in parts:
            y = part.outer(y, float(first) * h)
        tables = (self.composition.weights, self.composition.nodes, between[1:])
        entries = tuple(jnp.asarray(table, h.dtype) for table in tables)
        return jax.lax.scan(stage, y, entries, unroll=self.composition.stages == 1)[0]


# ---- whether a system is free motion and kicks: found by derivatives at random states ------------------------------

#: Random states to look at.
_DRAWS = 3

_OTHERWISE = "tx.RKMK(tableau) takes every system"


def _check(dynamics: Dynamics, motions: Sequence[FreeMotion]) -> None:
    """Compare a system with the free motions of its parts. Raises ModelError with the differences.

    Rates that are free motion and kicks have three marks, and these are looked at where states are random numbers: the
    rates of positions are those of the free motion; the derivatives of the rates of velocities with respect to all
    velocities are those of the free motion, and vanish at rest; parameters that the free motion does not read do not
    change them. Derivatives, because differences of rates would drown in large forces.
    """
    covered = [name for motion in motions for name in (motion.position, motion.velocity)]
    known = [state.name for state in dynamics.states]
    for name in covered:
        if name not in known:
            raise ModelError(f"Splitting: {name!r} is not a state of the system; it has: {', '.join(map(repr, known))}")
        if covered.count(name) > 1:
            raise ModelError(f"Splitting: state {name!r} belongs to two parts of {list(motions)!r}")
    missing = [name for name in known if name not in covered]
    if missing:
        raise ModelError(
            f"Splitting: no body covers state {missing[0]!r}.\n"
            "  fix: add a tx.FreeBody or a tx.FreeParticle to bodies; "
            f"a state that is neither a position nor a velocity has no free motion, but {_OTHERWISE}"
        )
    for motion in motions:
        motion.check(dynamics)
    rng = np.random.default_rng(5)
    with jax.ensure_compile_time_eval():
        compare = jax.jit(lambda *draw: _compared(dynamics, motions, *draw))
        for _ in range(_DRAWS):
            rates = jax.device_get(compare(*_drawn(dynamics, rng)))
            for motion in motions:
                _judge(motion, rates)


def _compared(
    dynamics: Dynamics, motions: Sequence[FreeMotion], t: Any, d: Arrays, u: Arrays, params: Arrays, direction: Arrays
) -> dict[str, Any]:
    """What is compared at the state Exp(d), by its name, the parameters moved in a direction; traceable."""
    x = {name: group.exp(d[name].reshape(-1)) for name, group in dynamics.group.factors.items()}
    names = [motion.velocity for motion in motions]
    velocities = {name: x[name] for name in names}

    def system(velocities: Arrays, params: Arrays) -> Arrays:
        return dynamics.functions.vector_field(t, x | velocities, u, params)

    def free(velocities: Arrays, params: Arrays) -> Arrays:
        rates = [motion.rates(dynamics, x | velocities, params) for motion in motions]
        return {name: rate for rate_of_motion in rates for name, rate in rate_of_motion.items()}

    def slopes(rates: Any, velocities: Arrays, params: Arrays) -> dict[str, Any]:
        """The derivatives of the rates of velocities by all velocities, a matrix each."""
        flat, read = ravel_pytree(velocities)
        return jax.jacfwd(lambda z: {n: rates(read(z), params)[n].reshape(-1) for n in names})(flat)

    read = {name for motion in motions for name in motion.parameters}
    moved = {n: jnp.zeros_like(d) if n in read else d for n, d in direction.items()}
    return {
        "system": slopes(system, velocities, params),
        "free": slopes(free, velocities, params),
        "rest": slopes(system, {name: jnp.zeros_like(value) for name, value in velocities.items()}, params),
        "change": jax.jvp(lambda p: slopes(system, velocities, p), (params,), (moved,))[1] if params else {},
        "position": (system(velocities, params), free(velocities, params)),
    }


def _judge(motion: FreeMotion, compared: dict[str, Any]) -> None:
    position, velocity = motion.position, motion.velocity
    ours, theirs = (rates[position] for rates in compared["position"])
    tolerance = float(np.sqrt(np.finfo(theirs.dtype).eps))
    if not np.abs(ours - theirs).max() <= tolerance * np.abs(theirs).max():
        raise ModelError(
            f"Splitting: the rate of {position!r} is not the velocity of {motion!r}.\n"
            f"  fix: for a FreeBody it is the body velocity, or J^-1 or M^-1 times the body momentum; {_OTHERWISE}"
        )
    system, free, rest = (compared[kind][velocity] for kind in ("system", "free", "rest"))
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
    if compared["change"] and np.abs(compared["change"][velocity]).max() > tolerance * size:
        raise ModelError(
            f"Splitting: the inertia of {motion!r} depends on parameters of the system that its argument inertia "
            "does not contain.\n"
            "  fix: give inertia as the Parameter, its name, or an expression of parameters; or make the parameters "
            "constants: tx.compile(system, bake={...})"
        )


def _drawn(dynamics: Dynamics, rng: np.random.Generator) -> tuple[Any, ...]:
    """A random time, tangents of states, controls, parameters, and a direction of the parameters."""
    d = {
        state.name: rng.normal(size=state.group.dimension) * np.ravel(1.0 if state.scale is None else state.scale)
        for state in dynamics.states
    }
    u = {control.name: rng.normal(size=control.shape) for control in dynamics.controls}
    params = {parameter.name: _near(parameter, rng) for parameter in dynamics.parameters}
    direction = {name: np.where(a == 0.0, 1.0, a) * rng.normal(size=a.shape) for name, a in params.items()}
    drawn = (rng.uniform(0.0, 2.0), d, u, params, direction)
    return jax.tree.map(lambda value: jnp.asarray(value, jax.dtypes.canonicalize_dtype(float)), drawn)


def _near(parameter: Parameter, rng: np.random.Generator) -> np.ndarray:
    """A random value near the default of a parameter, of the same form; without a default one of a real body."""
    share = rng.uniform(0.8, 1.2)
    if parameter.value is not None:
        return np.asarray(share * parameter.value)
    if parameter.shape == (3, 3):
        arm = rng.normal(size=(3, 3))
        return np.eye(3) + 0.1 * (arm @ arm.T)
    if parameter.shape in ((6,), (6, 6)):
        diagonal = np.array([share, share, share, *rng.uniform(1.0, 2.0, size=3)])
        return diagonal if parameter.shape == (6,) else np.diag(diagonal)
    return np.asarray(rng.uniform(1.0, 2.0, size=parameter.shape))
