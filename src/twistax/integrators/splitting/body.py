"""Free motion for splitting methods: points and rigid bodies, whose momenta in world axes are constant."""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...errors import ModelError
from ...expr import Constant, Expr, Inputs, Parameter, State, evaluate_all, leaves_of, to_expr
from ...groups import Group, quaternions, se3, so3
from ...groups.arrays import Components, add, scale, vector
from ...system.dynamics import Arrays, Dynamics
from ..charts.chart import Ambient, conjugate, tightened
from ..charts.coordinates import Blocks, Coordinates, StoredState
from .inertia import BodyInertia, arrays, rigid, rotational


class Flows(StoredState):
    """The free motion of a part of a system with its parameters, as a product of exact flows.

    The kinetic energy is a sum; `outer` is the exact flow of its main part, and `inner` are the flows of the rest.
    `enter`, `value` and `at_rest` read the states of this part; the flows return all stored states. Pure and traceable.
    """

    @abstractmethod
    def at_rest(self, y: Blocks) -> Arrays:
        """The states as values for expressions, with zero velocities."""

    @abstractmethod
    def outer(self, y: Blocks, dt: jax.Array) -> Blocks:
        """The stored states after dt under the main part of the free motion."""

    def inner(self, y: Blocks, dt: jax.Array, backwards: bool) -> Blocks:
        """The stored states after dt under the flows of the other parts in turn; in reverse order if backwards."""
        return y

    @abstractmethod
    def kick(self, y: Blocks, rates: Arrays, dt: jax.Array) -> Blocks:
        """The stored states after dt under the forces that cause these rates at rest: momenta
        change, positions do not.
        """

    def settle(self, y: Blocks) -> Blocks:
        """The stored states, projected back to the group."""
        return y


class FreeMotion(ABC):
    """The states of a system that move freely between kicks, and their motion. Hashable.

    Attributes:
        position: the name of the state that the free motion changes.
        velocity: the name of the state that forces change, a velocity or a momentum.
        parameters: the names of the parameters that the free motion reads.
    """

    position: str
    velocity: str
    parameters: tuple[str, ...]

    @abstractmethod
    def check(self, dynamics: Dynamics) -> None:
        """Check that states and parameters have the right kind. Raises ModelError for one that does not."""

    @abstractmethod
    def rates(self, dynamics: Dynamics, x: Arrays, params: Arrays) -> Arrays:
        """The rates of the two states in free motion as functions of plain values, for comparison with the system."""

    @abstractmethod
    def flows(self, dynamics: Dynamics, params: Arrays) -> Flows:
        """The flows of the free motion."""


def name_of(leaf: Any) -> str:
    """The name of a state, from the state or its name. Raises ModelError for other objects."""
    if isinstance(leaf, State):
        return leaf.name
    if not isinstance(leaf, str):
        raise ModelError(f"a body expects its states or their names, got {leaf!r}")
    return leaf


@dataclasses.dataclass(frozen=True)
class FreeParticle(FreeMotion):
    """A particle, or any other system with $p' = v$: two states of one shape without a group, in uniform motion without
    forces.

    The rate of v is the acceleration; no mass is needed.

    Args:
        position, velocity: p and v, states or their names.

    Raises:
        ModelError: when integrated: states of another kind.
    """

    position: Any
    velocity: Any
    parameters = ()

    def __post_init__(self) -> None:
        for field in ("position", "velocity"):
            object.__setattr__(self, field, name_of(getattr(self, field)))

    def check(self, dynamics: Dynamics) -> None:
        groups = [dynamics.group.factors[name] for name in (self.position, self.velocity)]
        if not all(group.flat for group in groups) or groups[0].shape != groups[1].shape:
            raise ModelError(
                f"{self!r}: expects two states without a group and of one shape, got {groups[0].name} and "
                f"{groups[1].name}.\n"
                "  fix: for a rotation or a pose use tx.FreeBody(pose, velocity, inertia=...)"
            )

    def rates(self, dynamics: Dynamics, x: Arrays, params: Arrays) -> Arrays:
        v = x[self.velocity]
        return {self.position: v, self.velocity: jnp.zeros_like(v)}

    def flows(self, dynamics: Dynamics, params: Arrays) -> Flows:
        return _ParticleFlows(
            self.position, self.velocity, Ambient().coordinates(dynamics.group.factors[self.position])
        )


@dataclasses.dataclass(frozen=True)
class _ParticleFlows(Flows):
    position: str
    velocity: str
    part: Coordinates

    def enter(self, x: Arrays) -> Blocks:
        return {name: begun(self.part.enter(x[name])) for name in (self.position, self.velocity)}

    def value(self, y: Blocks) -> Arrays:
        return {name: self.part.value(value(y[name])) for name in (self.position, self.velocity)}

    def at_rest(self, y: Blocks) -> Arrays:
        p = self.part.value(value(y[self.position]))
        return {self.position: p, self.velocity: jnp.zeros_like(p)}

    def outer(self, y: Blocks, dt: jax.Array) -> Blocks:
        return y | {self.position: increased(y[self.position], scale(dt, value(y[self.velocity])))}

    def kick(self, y: Blocks, rates: Arrays, dt: jax.Array) -> Blocks:
        change = self.part.rate(rates[self.velocity])
        return y | {self.velocity: increased(y[self.velocity], scale(dt, change))}


class FreeBody(FreeMotion):
    """A rigid body: an attitude on SO(3) or a pose on SE(3), and its velocity or momentum in body axes.

    Without forces its momenta in world axes are constant: $R' = R [w]x$ and $J w' = (J w) x w$, or $g' = g hat(V)$ and
    $M V' = -ad*_V (M V)$. An attitude rotates about the origin of its frame, a pose also moves; its centre of mass may
    be anywhere. Bodies with equal states and inertia are equal.

    Args:
        pose: the attitude or the pose, a state or its name.
        velocity: the state that is its body velocity, (3,) or (6,) in the order of the pose.
        momentum: alternatively, the state that is its body momentum J w or M V, about the frame's origin.
        inertia: for an attitude the moments (3,) about the body's axes, or a tensor (3, 3), about the origin, kg m2;
            for a pose the spatial inertia (6, 6) in its order, or its diagonal (6,). It is an array; or, so that it can
            change from run to run, a Parameter of the system, its name, or an expression of its parameters. An array is
            faster, in particular than a matrix of parameters, whose principal axes are unknown.

    Raises:
        ModelError: both or neither of velocity and momentum; an inertia that depends on more than parameters. When
            integrated: states of another kind, or an inertia that is not physical. For a matrix of parameters the last
            error can only occur during the integration; its first step then results in NaN.
    """

    def __init__(self, pose: Any, velocity: Any = None, *, momentum: Any = None, inertia: Any) -> None:
        if (velocity is None) == (momentum is None):
            raise ModelError("FreeBody expects either velocity=... or momentum=...: the state that forces change")
        self._is_momentum = velocity is None
        self.position = name_of(pose)
        self.velocity = name_of(momentum if self._is_momentum else velocity)
        if isinstance(inertia, str):
            self.inertia: Expr | str = inertia
            self.parameters, key = (inertia,), inertia
        else:
            self.inertia, self.parameters = expr, _ = _inertia_of(inertia)
            key = expr.key()
        self.key = (self.position, self.velocity, self._is_momentum, key)

    def __repr__(self) -> str:
        kind = "momentum" if self._is_momentum else "velocity"
        return f"FreeBody(pose={self.position!r}, {kind}={self.velocity!r})"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, FreeBody) and self.key == other.key

    def __hash__(self) -> int:
        return hash(self.key)

    def check(self, dynamics: Dynamics) -> None:
        group = dynamics.group.factors[self.position]
        if not group.rigid:
            raise ModelError(
                f"{self!r}: state {self.position!r} is not a rotation or a pose, its group is {group.name}.\n"
                "  fix: for a point use a tx.FreeParticle(position, velocity)"
            )
        shape, wanted = dynamics.group.factors[self.velocity].shape, (group.dimension,)
        if shape != wanted:
            raise ModelError(f"{self!r}: state {self.velocity!r} must have shape {wanted}, it has {shape}")
        known = {leaf.name for leaf in dynamics.parameters}
        for name in self.parameters:
            if name not in known:
                raise ModelError(
                    f"{self!r}: inertia reads parameter {name!r}, which the system does not have; it has: "
                    f"{', '.join(map(repr, known)) or 'none'}.\n"
                    "  fix: if it is a constant of the compiled system, pass its value as an array"
                )
            if not any(name in dynamics.functions.rate_reads(state.name) for state in dynamics.states):
                raise ModelError(f"{self!r}: inertia reads parameter {name!r}, which no rate reads")
        source = self._source(dynamics)
        n = group.dimension
        shapes = ((n,), (n, n))
        if source.shape not in shapes:
            raise ModelError(
                f"{self!r}: inertia expects shape {shapes[0]} or {shapes[1]} on {group.name}, got {source.shape}"
            )
        if isinstance(source, Constant):
            self._body_inertia(group, _evaluated(source, {}), None)

    def rates(self, dynamics: Dynamics, x: Arrays, params: Arrays) -> Arrays:
        group, velocity = dynamics.group.factors[self.position], x[self.velocity]
        M = jnp.asarray(_evaluated(self._source(dynamics), params), velocity.dtype)
        M = M if M.ndim == 2 else jnp.diag(M)
        twist = jnp.linalg.solve(M, velocity) if self._is_momentum else velocity
        if group.dimension == 6:
            body, momentum = group.to_linear_first(twist), group.to_linear_first(M @ twist)
            # Swapping the two parts undoes itself.
            turning = group.to_linear_first(-se3.coad(body, momentum))
        else:
            turning = -so3.coad(twist, M @ twist)
        change = turning if self._is_momentum else jnp.linalg.solve(M, turning)
        return {self.position: twist, self.velocity: change}

    def flows(self, dynamics: Dynamics, params: Arrays) -> Flows:
        group, source = dynamics.group.factors[self.position], self._source(dynamics)
        default = None
        if not isinstance(source, Constant):
            values = {leaf.name: leaf.value for leaf in leaves_of(source) if isinstance(leaf, Parameter)}
            if all(value is not None for value in values.values()):
                with jax.ensure_compile_time_eval():
                    default = np.asarray(_evaluated(source, values), np.float64)
        inertia = self._body_inertia(group, _evaluated(source, params), default)
        return _BodyFlows((self.position, self.velocity), group, inertia, self._is_momentum)

    def _source(self, dynamics: Dynamics) -> Expr:
        """The inertia, a name replaced by its parameter."""
        if isinstance(self.inertia, Expr):
            return self.inertia
        return next(leaf for leaf in dynamics.parameters if leaf.name == self.inertia)

    def _body_inertia(self, group: Group, value: Any, default: np.ndarray | None) -> BodyInertia:
        place = f"{self!r}: inertia"
        if group.dimension == 3:
            return rotational(place, value, default)
        if group.angular[0]:
            value, default = (None if a is None else _swapped(a) for a in (value, default))
        return rigid(place, value, default)


def _inertia_of(inertia: Any) -> tuple[Expr, tuple[str, ...]]:
    """The inertia as an expression, and the names of its parameters."""
    try:
        expr = to_expr(inertia)
    except ModelError as error:
        raise ModelError(
            f"FreeBody expects inertia to be numbers, a Parameter or its name: {error}\n"
            "  fix: pass traced values through a Parameter of the system: inertia='J', params={'J': ...}"
        ) from None
    leaves = list(leaves_of(expr))
    names = tuple(leaf.name for leaf in leaves if isinstance(leaf, Parameter))
    if not (isinstance(expr, Constant) or names) or not all(isinstance(a, (Parameter, Constant)) for a in leaves):
        raise ModelError(f"FreeBody expects inertia to be an array or an expression of parameters, got {inertia!r}")
    if isinstance(expr, Constant) and not np.isfinite(expr.value).all():
        raise ModelError("FreeBody expects a finite inertia")
    return expr, names


def _evaluated(source: Expr, params: Mapping[str, Any]) -> Any:
    """The value: of a constant an array of NumPy."""
    if isinstance(source, Constant):
        return np.asarray(source.value, np.float64)
    values = {name: jnp.asarray(value) for name, value in params.items()}
    dtype = jnp.result_type(*(values.values() or (float,)))
    inputs = Inputs(jnp.zeros((), dtype), {}, {}, values, dtype)
    return evaluate_all([source], lambda leaf: leaf.read(inputs))[0]


def _swapped(M: Any) -> Any:
    """A spatial inertia, or its diagonal, with linear and angular part exchanged."""
    return (np if isinstance(M, np.ndarray) else jnp).roll(M, 3, axis=tuple(range(M.ndim)))


class _BodyFlows(Flows):
    """Stored: q, for a pose also the sum of the centre of mass; the sum of L about the centre, for a pose also of p.

    The centre of an attitude is the origin of its frame. Momenta and the centre of mass are in world axes.
    """

    def __init__(self, names: tuple[str, str], group: Group, inertia: BodyInertia, is_momentum: bool) -> None:
        self.position, self.velocity = names
        self.group, self.inertia, self.part = group, inertia, Ambient().coordinates(group)
        # From the second state, or its rate at rest, to momenta in body axes, and back.
        self.into = inertia.centered if is_momentum else inertia.momenta
        self.out = inertia.about_origin if is_momentum else inertia.velocity

    def enter(self, x: Arrays) -> Blocks:
        pose = self.part.enter(x[self.position])
        momenta = self.into(self.part.rate(x[self.velocity]))
        stored = (*pose[:4], *begun(add(pose[4:], self._arm(pose))))
        return {self.position: stored, self.velocity: begun(_turned(pose[:4], momenta))}

    def value(self, y: Blocks) -> Arrays:
        q, momenta = y[self.position][:4], value(y[self.velocity])
        velocity = vector(self.out(_turned(conjugate(q), momenta)))
        # Swapping the two parts undoes itself.
        return {self.position: self._pose(y), self.velocity: self.group.to_linear_first(velocity)}

    def at_rest(self, y: Blocks) -> Arrays:
        pose = self._pose(y)
        return {self.position: pose, self.velocity: jnp.zeros(self.group.dimension, pose.dtype)}

    def outer(self, y: Blocks, dt: jax.Array) -> Blocks:
        pose, momenta = y[self.position], value(y[self.velocity])
        q = self.inertia.spin.symmetric(pose[:4], momenta[:3], dt)
        return y | {self.position: (*q, *increased(pose[4:], scale(dt / self.inertia.mass, momenta[3:])))}

    def inner(self, y: Blocks, dt: jax.Array, backwards: bool) -> Blocks:
        pose = y[self.position]
        q = self.inertia.spin.flow_of_other_axes(pose[:4], y[self.velocity][:3], dt, backwards)
        return y | {self.position: (*q, *pose[4:])}

    def kick(self, y: Blocks, rates: Arrays, dt: jax.Array) -> Blocks:
        force = _turned(y[self.position][:4], self.into(self.part.rate(rates[self.velocity])))
        return y | {self.velocity: increased(y[self.velocity], scale(dt, force))}

    def settle(self, y: Blocks) -> Blocks:
        pose = y[self.position]
        return y | {self.position: (*tightened(pose[:4]), *pose[4:])}

    def _pose(self, y: Blocks) -> jax.Array:
        stored = y[self.position]
        return self.part.value((*stored[:4], *add(value(stored[4:]), scale(-1.0, self._arm(stored)))))

    def _arm(self, pose: Components) -> Components:
        """From the origin of the frame of a pose to the centre of mass, in world axes; empty for an attitude."""
        return quaternions.rotate(pose[:4], arrays(self.inertia.center, pose[0])) if self.inertia.center else ()


def _turned(q: Components, vectors: Components) -> Components:
    """Every three numbers rotated by q."""
    parts = [quaternions.rotate(q, vectors[i : i + 3]) for i in range(0, len(vectors), 3)]
    return tuple(number for part in parts for number in part)


# ---- sums: values, then what of their last increments is not in them, which is added the next time -----------------


def begun(values: Components) -> Components:
    """A compensated sum that starts at these values."""
    return (*values, *(jnp.zeros_like(value) for value in values))


def value(total: Components) -> Components:
    """The values of a sum."""
    return total[: len(total) // 2]


def increased(total: Components, increments: Components) -> Components:
    """The sum with increments added.

    Source: Hairer, Lubich, Wanner, Geometric Numerical Integration (2006), section VIII.5 (compensated summation).
    """
    values, rounding = value(total), total[len(total) // 2 :]
    wanted = tuple(d + e for d, e in zip(increments, rounding, strict=True))
    new = tuple(x + d for x, d in zip(values, wanted, strict=True))
    return (*new, *(d - (y - x) for d, y, x in zip(wanted, new, values, strict=True)))
