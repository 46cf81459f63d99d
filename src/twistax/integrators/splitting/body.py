"""A rigid body in free motion."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...errors import ModelError
from ...expr import Constant, Expr, Inputs, Parameter, evaluate_all, leaves_of
from ...groups import SpecialEuclidean, SpecialOrthogonal, se3, so3
from ...lowering import Dynamics
from ...lowering.dynamics import Arrays
from .body_flows import AttitudeFlows, PoseFlows
from .inertia import CenteredInertia, RotationalInertia, rigid, rotational
from .motion import Flows, FreeMotion, name_of

__all__ = ["FreeBody"]


class FreeBody(FreeMotion):
    """A rigid body: an attitude on SO(3) or a pose on SE(3), and its velocity or momentum in body axes.

    Free, it keeps its momenta in the world: R' = R [w]x and J w' = (J w) x w, or g' = g V^ and
    M V' = -ad*_V (M V). An attitude turns about the origin of its frame, a pose also moves; its centre of mass may sit
    anywhere. Equal where states and inertia are.

    Args:
        pose: the attitude or the pose, a state or its name.
        velocity: the state that is its body velocity, (3,) or (6,) in the order of the pose.
        momentum: instead, the state that is its body momentum J w or M V, about the frame's origin.
        inertia: for an attitude moments (3,) about the body's axes, or a tensor (3, 3), about the origin, kg m2; for a
            pose the spatial inertia (6, 6) in its order, or its diagonal (6,). An array; or a Parameter of the system,
            its name, or an expression of its parameters, which may then differ from run to run. An array is faster, by
            far where parameters make a matrix: then the principal axes are not known.

    Raises:
        ModelError: not one of velocity and momentum; an inertia that reads anything but parameters. When flown: states
            of another kind, or an inertia that belongs to no body. A matrix of parameters that belongs to none cannot
            be told apart before a flight, which then ends at its first step.
    """

    def __init__(self, pose: Any, velocity: Any = None, *, momentum: Any = None, inertia: Any) -> None:
        if (velocity is None) == (momentum is None):
            raise ModelError("FreeBody expects either velocity=... or momentum=...: the state that forces change")
        self._is_momentum = velocity is None
        self.position = name_of(pose)
        self.velocity = name_of(momentum if self._is_momentum else velocity)
        self.inertia = _inertia_of(inertia)
        self.parameters = _parameters_of(self.inertia)

    def __repr__(self) -> str:
        kind = "momentum" if self._is_momentum else "velocity"
        return f"FreeBody(pose={self.position!r}, {kind}={self.velocity!r})"

    def _key(self) -> tuple[Any, ...]:
        own = self.inertia
        key = own.key() if isinstance(own, Expr) else (own.shape, own.tobytes()) if isinstance(own, np.ndarray) else own
        return (self.position, self.velocity, self._is_momentum, key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, FreeBody) and self._key() == other._key()

    def __hash__(self) -> int:
        return hash(self._key())

    def check(self, dynamics: Dynamics) -> None:
        group = dynamics.group.factors[self.position]
        if not isinstance(group, (SpecialOrthogonal, SpecialEuclidean)):
            raise ModelError(
                f"{self!r}: state {self.position!r} is no rotation or pose, it lives on {group.name}.\n"
                "  fix: a point is a tx.FreeParticle(position, velocity)"
            )
        found, wanted = dynamics.group.factors[self.velocity].shape, (group.dimension,)
        if found != wanted:
            raise ModelError(f"{self!r}: state {self.velocity!r} must have shape {wanted}, it has {found}")
        known = {leaf.name for leaf in dynamics.parameters}
        for name in self.parameters:
            if name not in known:
                raise ModelError(
                    f"{self!r}: inertia reads parameter {name!r}, which the system does not have; it has: "
                    f"{', '.join(map(repr, known)) or 'none'}.\n  fix: where it is baked, give its value as an array"
                )
            if not any(name in dynamics._functions.rate_reads(state.name) for state in dynamics.states):
                raise ModelError(f"{self!r}: inertia reads parameter {name!r}, which no rate reads")
        shape = self._source(dynamics).shape
        shapes = ((3,), (3, 3)) if isinstance(group, SpecialOrthogonal) else ((6,), (6, 6))
        if shape not in shapes:
            raise ModelError(f"{self!r}: inertia expects shape {shapes[0]} or {shapes[1]} on {group.name}, got {shape}")
        source = self._source(dynamics)
        if isinstance(source, np.ndarray):
            self._of_body(dynamics, source, None)

    def rates(self, dynamics: Dynamics, x: Arrays, params: Arrays) -> Arrays:
        group, velocity = dynamics.group.factors[self.position], x[self.velocity]
        M = jnp.asarray(self._value(dynamics, params), velocity.dtype)
        M = M if M.ndim == 2 else jnp.diag(M)
        twist = jnp.linalg.solve(M, velocity) if self._is_momentum else velocity
        if isinstance(group, SpecialEuclidean):
            order = group.order
            body, momentum = order.to_linear_first(twist), order.to_linear_first(M @ twist)
            turning = order.from_linear_first(-se3.coad(body, momentum))
        else:
            turning = -so3.coad(twist, M @ twist)
        change = turning if self._is_momentum else jnp.linalg.solve(M, turning)
        return {self.position: twist, self.velocity: change}

    def flows(self, dynamics: Dynamics, params: Arrays) -> Flows:
        group = dynamics.group.factors[self.position]
        source = self._source(dynamics)
        known = None if isinstance(source, np.ndarray) else _default(source)
        own = self._of_body(dynamics, self._value(dynamics, params), known)
        names = (self.position, self.velocity)
        into, out = (own.centered, own.about_origin) if self._is_momentum else (own.momenta, own.velocity)
        if isinstance(own, CenteredInertia) and isinstance(group, SpecialEuclidean):
            return PoseFlows(names, group, own, into, out)
        return AttitudeFlows(names, group, own, into, out)

    def _source(self, dynamics: Dynamics) -> Expr | np.ndarray:
        """The inertia, a name replaced by its parameter."""
        if not isinstance(self.inertia, str):
            return self.inertia
        return next(leaf for leaf in dynamics.parameters if leaf.name == self.inertia)

    def _value(self, dynamics: Dynamics, params: Arrays) -> np.ndarray | jax.Array:
        source = self._source(dynamics)
        return source if isinstance(source, np.ndarray) else _evaluated(source, params)

    def _of_body(self, dynamics: Dynamics, value: Any, known: np.ndarray | None) -> RotationalInertia | CenteredInertia:
        """The inertia from its value, constant or traced, and its default where there is one."""
        group, place = dynamics.group.factors[self.position], f"{self!r}: inertia"
        if not isinstance(group, SpecialEuclidean):
            return rotational(place, value, known)
        if not group.order.linear_leads:
            value, known = (None if a is None else _swapped(a) for a in (value, known))
        return rigid(place, value, known)


def _inertia_of(given: Any) -> Expr | np.ndarray | str:
    """The inertia as it is kept: a read-only array, an expression of parameters, or a name."""
    if isinstance(given, Constant):
        given = given.value
    if isinstance(given, str):
        return given
    if isinstance(given, Expr):
        leaves = leaves_of(given)
        if not any(isinstance(leaf, Parameter) for leaf in leaves) or not all(
            isinstance(leaf, (Parameter, Constant)) for leaf in leaves
        ):
            raise ModelError(f"FreeBody expects inertia to be an array or an expression of parameters, got {given!r}")
        return given
    try:
        array = np.array(given, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ModelError(
            f"FreeBody expects inertia to be numbers, a Parameter or its name: {error}\n"
            "  fix: what is traced goes through a Parameter of the system: inertia='J', params={'J': ...}"
        ) from None
    if not np.isfinite(array).all():
        raise ModelError("FreeBody expects a finite inertia")
    array.setflags(write=False)
    return array


def _parameters_of(inertia: Expr | np.ndarray | str) -> tuple[str, ...]:
    if isinstance(inertia, str):
        return (inertia,)
    leaves = leaves_of(inertia) if isinstance(inertia, Expr) else ()
    return tuple(leaf.name for leaf in leaves if isinstance(leaf, Parameter))


def _evaluated(source: Expr, params: Mapping[str, Any]) -> jax.Array:
    arrays = {name: jnp.asarray(value) for name, value in params.items()}
    dtype = jnp.result_type(*(arrays.values() or (float,)))
    inputs = Inputs(jnp.zeros((), dtype), {}, {}, arrays, dtype)
    return evaluate_all([source], lambda leaf: leaf.read(inputs))[0]


def _default(source: Expr) -> np.ndarray | None:
    """The inertia with the parameters' own values; None where one has none."""
    own = {leaf.name: leaf.value for leaf in leaves_of(source) if isinstance(leaf, Parameter)}
    if any(value is None for value in own.values()):
        return None
    with jax.ensure_compile_time_eval():
        return np.asarray(_evaluated(source, own), np.float64)


def _swapped(M: Any) -> Any:
    """A spatial inertia, or its diagonal, with linear and angular part exchanged."""
    return (np if isinstance(M, np.ndarray) else jnp).roll(M, 3, axis=tuple(range(M.ndim)))
