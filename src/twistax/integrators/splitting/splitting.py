"""Splitting methods: free motion and kicks, one after the other."""

from __future__ import annotations

import dataclasses
import weakref
from typing import Any

import jax
import jax.numpy as jnp

from ...errors import ModelError
from ...lowering import Dynamics
from ...lowering.dynamics import Arrays
from ..charts.coordinates import Blocks
from ..method import Method, VectorField
from .check import check_motions
from .compositions import Composition
from .motion import AllFlows, FreeMotion

__all__ = ["Splitting"]

#: What was found to fit: parts by system.
_CHECKED: weakref.WeakKeyDictionary[Dynamics, set[tuple[FreeMotion, ...]]] = weakref.WeakKeyDictionary()


@dataclasses.dataclass(frozen=True)
class Splitting(Method):
    """A splitting method for bodies in a potential, explicit, reversible and symplectic: for long runs.

    For forces and torques that depend on poses, time, controls and parameters, but not on velocities. With S the exact
    free motion of symmetric bodies, r_1, r_2, ... those of what else is in the kinetic energy, and K the kick by all
    forces, a step of length h is composed of the symmetric steps

        S(h/2) r_1(h/2) r_2(h/2) ... K(h) ... r_2(h/2) r_1(h/2) S(h/2),

    neighbouring S made one: an evaluation of the rates a stage, never at the ends of a step. The rates at rest are the
    kicks, so any compiled system of this form will do; others are refused. Between steps momenta are stored in world
    axes: what no force changes stays to the last bit. Energy errors stay bounded as long as steps resolve the motion.
    Fixed steps.

    Attributes:
        composition: `tx.compositions.KAHAN_LI8` or another.
        bodies: what moves, a `tx.FreeBody` or `tx.FreeParticle` or several, which share all states of the system.

    Raises:
        ModelError: no composition, or no bodies. When integrated: states that no body covers; forces that depend on
            velocities; an inertia that is not that of the system.

    Source: Hairer, Lubich, Wanner, Geometric Numerical Integration (2006), sections II.5 and V.3 (splitting and
    composition) and VII.5 (rigid bodies).
    """

    composition: Composition
    bodies: Any

    def __post_init__(self) -> None:
        if not isinstance(self.composition, Composition):
            raise ModelError(
                f"Splitting expects a composition like tx.compositions.KAHAN_LI8, got {self.composition!r}"
            )
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
        """Raises ModelError, with the reason, for a system whose forces depend on velocities and for a wrong inertia.

        Found by derivatives at random states, once for a system and its bodies.
        """
        known = _CHECKED.setdefault(dynamics, set())
        if self.bodies not in known:
            check_motions(dynamics, self.bodies)
            known.add(self.bodies)

    def stored(self, dynamics: Dynamics, params: Arrays) -> AllFlows:
        return AllFlows([body.flows(dynamics, params) for body in self.bodies])

    def advance(self, field: VectorField, t: jax.Array, y: Blocks, h: jax.Array) -> Blocks:
        """The stored state after one step of length h. Pure and traceable. The clock goes with the free motion."""
        flows = self.stored(field.dynamics, field.params)

        def stage(y: Blocks, entry: tuple[jax.Array, ...]) -> tuple[Blocks, None]:
            weight, node, further = entry
            y = flows.inner(y, 0.5 * weight * h, backwards=False)
            time = t + node * h
            rates = field(time, flows.at_rest(y))
            y = flows.kick(y, rates, weight * h)
            y = flows.inner(y, 0.5 * weight * h, backwards=True)
            return flows.settle(flows.outer(y, further * h)), None

        first, *_ = between = self.composition.between
        entries = (self.composition.weights, self.composition.nodes, between[1:])
        y = flows.outer(y, float(first) * h)
        tables = tuple(jnp.asarray(entry, h.dtype) for entry in entries)
        return jax.lax.scan(stage, y, tables, unroll=self.composition.stages == 1)[0]
