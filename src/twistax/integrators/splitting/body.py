"""A rigid body in free motion. Its momenta stand still in the world, and are stored there."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...errors import ModelError
from ...expr import Constant, Expr, Inputs, Parameter, evaluate_all, leaves_of
from ...groups import Group, SpecialEuclidean, SpecialOrthogonal, quaternions, se3, so3
from ...groups.arrays import Components, add, scale, vector
from ...lowering import Dynamics
from ...lowering.dynamics import Arrays
from ..charts import Ambient
from ..charts.coordinates import Blocks, tightened
from .inertia import CenteredInertia, RotationalInertia, rigid, rotational
from .motion import Flows, FreeMotion, Sum, begun, increased, name_of, value
from .spin import arrays, conjugate

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
        ModelError: not one of velocity and momentum; an inertia that reads anything but parameters. When integrated:
            states of another kind, or an inertia that belongs to no body. A matrix of parameters that belongs to none
            cannot be told apart before the first step, which then ends with NaN.
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
            return _PoseFlows(names, group, own, into, out)
        return _AttitudeFlows(names, group, own, into, out)

    def _source(self, dynamics: Dynamics) -> Expr | np.ndarray:
        """The inertia, a name replaced by its parameter."""
        if not isinstance(self.inertia, str):
            return self.inertia
        return next(leaf for leaf in dynamics.parameters if leaf.name == self.inertia)

    def _value(self, dynamics: Dynamics, params: Arrays) -> np.ndarray | jax.Array:
        source = self._source(dynamics)
        return source if isinstance(source, np.ndarray) else _evaluated(source, params)

    def _of_body(self, dynamics: Dynamics, value: Any, known: np.ndarray | None) -> RotationalInertia:
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


# ---- the flows ----------------------------------------------------------------------------------------------------

Map = Callable[[Components], Components]


class _AttitudeFlows(Flows):
    """A body that turns about the origin of its frame. Stored: (q,) and the sum of momentum in world axes.

    Args:
        names: of the attitude, and of its velocity or momentum.
        group: of the attitude.
        own: the inertia.
        into, out: from the second state, or its rate at rest, to momenta in body axes, and back.
    """

    def __init__(self, names: tuple[str, str], group: Group, own: RotationalInertia, into: Map, out: Map) -> None:
        self.position, self.velocity = names
        self.group, self.spin, self.into, self.out = group, own.spin, into, out
        self.part = Ambient().coordinates(group)

    def enter(self, x: Arrays) -> Blocks:
        pose = self.part.enter(x[self.position])
        momenta = self.into(self.part.rate(x[self.velocity]))
        return {self.position: self._to_center(pose), self.velocity: begun(_turned(pose[:4], momenta))}

    def value(self, y: Blocks) -> Arrays:
        pose, momenta = y[self.position], value(y[self.velocity])
        own = self.out(_turned(conjugate(pose[:4]), momenta))
        return {self.position: self.part.value(self._from_center(pose)), self.velocity: self._array(own)}

    def at_rest(self, y: Blocks) -> Arrays:
        pose = self.part.value(self._from_center(y[self.position]))
        return {self.position: pose, self.velocity: jnp.zeros(self.group.dimension, pose.dtype)}

    def outer(self, y: Blocks, dt: jax.Array) -> Blocks:
        pose, momenta = y[self.position], value(y[self.velocity])
        q = self.spin.symmetric(pose[:4], momenta[:3], dt)
        return {self.position: (*q, *self._carried(pose[4:], momenta, dt)), self.velocity: y[self.velocity]}

    def inner(self, y: Blocks, dt: jax.Array, backwards: bool) -> Blocks:
        pose, momenta = y[self.position], y[self.velocity]
        q = self.spin.others_flow(pose[:4], momenta[:3], dt, backwards)
        return {self.position: (*q, *pose[4:]), self.velocity: momenta}

    def kick(self, y: Blocks, rates: Arrays, dt: jax.Array) -> Blocks:
        pose, momenta = y[self.position], y[self.velocity]
        force = _turned(pose[:4], self.into(self.part.rate(rates[self.velocity])))
        return {self.position: pose, self.velocity: increased(momenta, scale(dt, force))}

    def settle(self, y: Blocks) -> Blocks:
        pose = y[self.position]
        return {self.position: (*tightened(pose[:4]), *pose[4:]), self.velocity: y[self.velocity]}

    def _array(self, own: Components) -> jax.Array:
        return vector(own)

    def _to_center(self, pose: Components) -> Components:
        return pose

    def _from_center(self, stored: Components) -> Components:
        return stored

    def _carried(self, center: Sum, momenta: Components, dt: jax.Array) -> Sum:
        return center


class _PoseFlows(_AttitudeFlows):
    """A body that also moves. Stored: q and the sum of the centre of mass; that of L about the centre of mass and of p.

    Momenta and the centre of mass are in world axes.
    """

    def __init__(
        self, names: tuple[str, str], group: SpecialEuclidean, own: CenteredInertia, into: Map, out: Map
    ) -> None:
        super().__init__(names, group, own, into, out)
        self.mass, self.center, self.order = own.mass, own.center, group.order

    def _array(self, own: Components) -> jax.Array:
        return self.order.from_linear_first(vector(own))

    def _to_center(self, pose: Components) -> Components:
        return (*pose[:4], *begun(add(pose[4:], self._arm(pose))))

    def _from_center(self, stored: Components) -> Components:
        return (*stored[:4], *add(value(stored[4:]), scale(-1.0, self._arm(stored))))

    def _carried(self, center: Sum, momenta: Components, dt: jax.Array) -> Sum:
        return increased(center, scale(dt / self.mass, momenta[3:]))

    def _arm(self, pose: Components) -> Components:
        """From the origin of the frame to the centre of mass, in world axes."""
        return quaternions.rotate(pose[:4], arrays(self.center, pose[0]))


def _turned(q: Components, vectors: Components) -> Components:
    """Every three numbers turned by q."""
    parts = [quaternions.rotate(q, vectors[i : i + 3]) for i in range(0, len(vectors), 3)]
    return tuple(number for part in parts for number in part)
