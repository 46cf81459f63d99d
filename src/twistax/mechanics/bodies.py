"""Rigid bodies: their spatial inertia, and the quantities that follow from it, as expressions.

Six-vectors are [v; w], [f; tau] and [p; L] about the origin of the body's frame, in its axes.

Source: R. Featherstone, Rigid Body Dynamics Algorithms (2008), chapter 2, for [w; v].
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..errors import ModelError, OperationError
from ..expr import Block, Constant, Cross, Dot, Expr, Outer, Parameter, Solve, canonicalize_all
from ..expr.fields import ExprLike
from ..expr.lie import Act, Hat, angular, linear, wrench
from ..expr.lie import twist as join
from ..expr.transformations.rate import changing, rates_by_name
from ..units import kilograms, metres
from .arguments import constant, of_shape, pose
from .inner_motion import InnerMotion, MovingMass, momentum_of, motion_of

#: Tolerances, relative to the largest entry, of the symmetry, positivity and triangle inequalities of an inertia
#: tensor.
_ROUND_OFF = 1e-9


class SpatialInertia:
    """Mass, centre of mass and inertia tensor of a rigid body, described in one frame fixed to it.

    NOTE: `inertia` is taken about the CENTRE OF MASS, in the axes of the frame. For a tensor about the frame's origin
    use `SpatialInertia.about_origin`.

    Each of the three is a number, an array, or an expression. Numbers, arrays and the default values of Parameters are
    checked to be physical; expressions of states are not checked. Points and thin rods, whose tensor is only positive
    semidefinite, are accepted, because they can be merged with other bodies; only `acceleration` raises an error for
    them.

    If centre or inertia depend on time or on states, masses move within the body. All functions include their momentum
    relative to the body: compared with a rigid body, there is an additional wrench $[f; I' w + c x f]$ with $f = m (2 w
    x c' + c'')$, see `inner_motion`. If the mass changes, mass leaves (or joins) the body with its momentum, and there
    are no such terms. Apply the forces of the leaving mass: the thrust and `flight.burning`. A mass that depends on
    time or on states counts as changing, unless the rates of these states are known to be zero.

    Args:
        mass: kg, ().
        center_of_mass: m, (3,), in the frame; its origin by default.
        inertia: kg m2, (3, 3), about the centre of mass.
        physical: False accepts values that are not physical.
        rates: rates of the states on which mass, centre and inertia depend, as in a System; zero for constant states. A
            moving centre also needs the rates of the states in these rates. The method `system` of a mechanism or a
            vehicle adds the rates of its own states.
        mass_leaves: whether a change of centre and inertia is due to leaving mass. None: it is if the mass changes.

    Raises:
        ShapeError: a value of another shape.
        ModelError: a mass that is not positive; an entry that is not finite; a tensor that is not symmetric, has a
            negative principal moment, or one above the sum of the other two; a changing mass with mass_leaves=False.
    Source: Featherstone, Rigid Body Dynamics Algorithms (2008), section 2.13, for M.
    Example: `SpatialInertia(mass=2.0, center_of_mass=(0.0, 0.0, 0.1), inertia=np.diag([0.02, 0.02, 0.01]))`.
    """

    def __init__(
        self,
        *positional: Any,
        mass: ExprLike = None,  # type: ignore[assignment]
        center_of_mass: ExprLike = (0.0, 0.0, 0.0),
        inertia: ExprLike = None,  # type: ignore[assignment]
        physical: bool = True,
        rates: Mapping[Any, ExprLike] | None = None,
        mass_leaves: bool | None = None,
    ) -> None:
        if positional:
            raise ModelError(
                "SpatialInertia takes its arguments by name: SpatialInertia(mass=..., center_of_mass=..., inertia=...)"
            )
        self.mass, self.center_of_mass, self.inertia = _parts_of(mass, center_of_mass, inertia)
        self.physical = physical
        if physical:
            _check(_known(self.mass), _known(self.center_of_mass), _known(self.inertia))
        part = MovingMass(self.mass, self.center_of_mass, self.inertia, rates_by_name(rates or {}))
        if mass_leaves is False and not part.mass_stays:
            raise ModelError(
                "SpatialInertia expects a mass that does not change where mass_leaves=False, got "
                f"{self.mass!r}: with a changing mass, mass leaves or joins the body.\n"
                "  fix: pass rates={...: 0.0} for each state that the constant mass depends on"
            )
        has_moving_part = mass_leaves is not True and changing(self.center_of_mass, self.inertia)
        #: The parts whose centre or inertia changes; for merged bodies the parts of both.
        self.changing_parts: tuple[MovingMass, ...] = (part,) if has_moving_part else ()
        #: The poses of all calls of `in_frame`.
        self.poses: tuple[Expr, ...] = ()

    @classmethod
    def about_origin(
        cls,
        *,
        mass: ExprLike,
        center_of_mass: ExprLike,
        inertia: ExprLike,
        rates: Mapping[Any, ExprLike] | None = None,
        mass_leaves: bool | None = None,
    ) -> SpatialInertia:
        """The body whose `inertia` (3, 3) is about the ORIGIN of the frame, in its axes: $I_c = I_o + m [c]x [c]x$.

        Args:
            mass, center_of_mass, rates, mass_leaves: as for the constructor.
            inertia: kg m2, (3, 3), about the origin.
        Raises:
            ShapeError, ModelError: as for the constructor. A tensor that is too small for the mass and its distance is
                not physical.
        """
        m, c, tensor = canonicalize_all(_parts_of(mass, center_of_mass, inertia))
        (tensor,) = canonicalize_all([tensor - _steiner(m, c)])
        return cls(mass=m, center_of_mass=c, inertia=tensor, rates=rates, mass_leaves=mass_leaves)

    @classmethod
    def _derived(
        cls,
        parts: tuple[Expr, Expr, Expr],
        physical: bool,
        changing_parts: tuple[MovingMass, ...],
        poses: tuple[Expr, ...],
    ) -> SpatialInertia:
        """A body computed from this one. Constants are folded, so that they are checked and printed as numbers."""
        m, c, tensor = canonicalize_all(parts)
        described = {"mass": m, "center_of_mass": c, "inertia": tensor}
        return cls(**described, physical=physical, mass_leaves=True)._changed(
            changing_parts=changing_parts, poses=poses
        )

    def _changed(self, **attributes: Any) -> SpatialInertia:
        body = copy.copy(self)
        body.__dict__.update(attributes)
        return body

    def with_rates(self, rates: Mapping[Any, ExprLike]) -> SpatialInertia:
        """The same body with rates of further states; existing rates are unchanged.

        Args:
            rates: as for the constructor.
        Raises: ModelError for keys that are neither states nor names.
        """
        return self._changed(changing_parts=tuple(part.knowing(rates_by_name(rates)) for part in self.changing_parts))

    @property
    def _moving(self) -> tuple[MovingMass, ...]:
        """The masses that move inside the body: parts that change at constant mass."""
        return tuple(part for part in self.changing_parts if part.mass_stays)

    @property
    def inner_motion(self) -> InnerMotion | None:
        """The effect of masses that move inside the body on its motion; None if nothing moves.

        Raises: ModelError for unknown rates, or a body that `in_frame` transformed by a varying pose.
        """
        for T in self.poses:
            constant("in_frame", "T", T)
        return motion_of(self._moving)

    def __repr__(self) -> str:
        return f"SpatialInertia(mass={self.mass!r}, center_of_mass={self.center_of_mass!r}, inertia={self.inertia!r})"

    @property
    def matrix(self) -> Expr:
        """$M = [m I, -m [c]x; m [c]x, I_c - m [c]x [c]x]$ (6, 6)."""
        moment = Hat(self.mass * self.center_of_mass)
        about_origin = self.inertia + _steiner(self.mass, self.center_of_mass)
        return Block([[self.mass * np.eye(3), -moment], [moment, about_origin]])

    @property
    def known_matrix(self) -> np.ndarray | None:
        """M (6, 6) as numbers; None if it depends on a leaf."""
        (M,) = canonicalize_all([self.matrix])
        return np.asarray(M.value) if isinstance(M, Constant) else None

    def momentum(self, V: ExprLike) -> Expr:
        """$[p; L]$ (6,) of a twist V (6,): $p = m (v + w x c + c')$, $L = I_c w + c x p$; N s, N m s.

        It is M V plus the momentum of masses that move in the body.

        Raises: ShapeError for an argument of another shape; ModelError for unknown rates.
        """
        v, w = _velocities("momentum", V)
        p = self.mass * self._velocity_of_center(v, w)
        rigid = wrench(force=p, torque=self._with_arm(self.inertia @ w, p))
        relative = momentum_of(self._moving)
        return rigid if relative is None else rigid + relative[0]

    def kinetic_energy(self, V: ExprLike) -> Expr:
        """$(m |v + w x c + c'|^2 + w . I_c w) / 2$ () of a twist V (6,), J.

        It excludes the kinetic energy of internal masses relative to their common centre, which centre and inertia do
        not determine.

        Raises: ShapeError; ModelError for unknown rates.
        """
        v, w = _velocities("kinetic_energy", V)
        u = self._velocity_of_center(v, w)
        rigid = 0.5 * (self.mass * Dot(u, u) + Dot(w, self.inertia @ w))
        relative = momentum_of(self._moving)
        return rigid if relative is None else rigid + Dot(relative[0], V) + relative[1]

    def weight(self, T: ExprLike, gravity: ExprLike) -> Expr:
        """The wrench $[m R^T a; c x m R^T a]$ (6,) of a uniform gravity a, at the body's origin in its axes.

        Args:
            T: the body's pose in the world, (4, 4).
            gravity: a (3,) in world axes, m/s2.
        Raises:
            ShapeError: an argument of another shape.
            ModelError: T is a numeric array and not a pose.
        """
        R = pose("weight", "T", T)[:3, :3]
        force = self.mass * (R.T @ of_shape("weight", "gravity", gravity, (3,), "a vector in world axes"))
        return wrench(force=force, torque=self._with_arm(Constant(np.zeros(3)), force))

    def acceleration(self, V: ExprLike, F: ExprLike) -> Expr:
        """$V' = M^-1 (F - ad*_V(M V))$ (6,), Newton and Euler about the centre of mass; no 6x6 matrix is built.

        $w' = I_c^-1 (tau - c x f - w x I_c w)$ and $v' = f/m - w x (v + w x c) - w' x c$. Where masses move in the body
        their wrench X is subtracted from F, see `inner_motion`. Where mass leaves it, F includes the thrust and all
        other forces of the leaving mass (Meshchersky); M is the instantaneous inertia.

        Args:
            V: the twist of the body (6,).
            F: the sum of all wrenches on the body (6,).
        Raises:
            ShapeError: an argument of another shape.
            ModelError: the inertia tensor is constant and singular; unknown rates.
        """
        tensor = _known(self.inertia)
        if tensor is not None and not positive_definite(tensor):
            raise ModelError(
                "acceleration expects an inertia with three positive principal moments, "
                f"got {np.linalg.eigvalsh(tensor).tolist()} kg m2.\n"
                "  fix: merge the point or rod with the rest of the body, or give it a thickness"
            )
        v, w = _velocities("acceleration", V)
        wrench_on_it = of_shape("acceleration", "F", F, (6,))
        inner = self.inner_motion
        if inner is not None:
            wrench_on_it = wrench_on_it - inner.wrench(w)
        f, tau = linear(wrench_on_it), angular(wrench_on_it)
        turning = Solve(self.inertia, self._with_arm(tau, -f) - Cross(w, self.inertia @ w))
        moving = f / self.mass - Cross(w, self._velocity_of_center(v, w))
        return join(linear=self._velocity_of_center(moving, -turning), angular=turning)

    def in_frame(self, T: ExprLike) -> SpatialInertia:
        """The same body described in frame a, with T = T_ab (4, 4) and b the present frame: $M_a = Ad*_T M Ad_T^-1$.

        Frame a must be fixed to the body, too. If T changes with the motion, `matrix` is the instantaneous inertia, and
        functions for accelerations and forces raise an error.

        Raises:
            ShapeError: T is not of shape (4, 4).
            ModelError: T is a numeric array and not a pose.
        """
        T_ab = pose("in_frame", "T", T)
        R = T_ab[:3, :3]

        def moved(c: Expr, tensor: Expr) -> tuple[Expr, Expr]:
            return Act(T_ab, c), R @ tensor @ R.T

        masses = tuple(MovingMass(p.mass, *moved(p.center_of_mass, p.inertia), p.rates) for p in self.changing_parts)
        described = (self.mass, *moved(self.center_of_mass, self.inertia))
        return self._derived(described, self.physical, masses, (*self.poses, T_ab))

    def merge(self, other: SpatialInertia) -> SpatialInertia:
        """The rigid union of two bodies described in one frame (see `in_frame`); also written `a + b`.

        Raises: ModelError if other is not a SpatialInertia.
        """
        if not isinstance(other, SpatialInertia):
            raise ModelError(f"merge expects another SpatialInertia, got {other!r}")
        physical, poses = self.physical and other.physical, self.poses + other.poses
        changing_parts = self.changing_parts + other.changing_parts
        for body, massless in ((self, other), (other, self)):
            if (
                isinstance(massless.mass, Constant) and not massless.mass.value
            ):  # two bodies without mass have no centre of mass
                parts = body.mass, body.center_of_mass, self.inertia + other.inertia
                return self._derived(parts, physical, changing_parts, poses)
        m = self.mass + other.mass
        c = (self.mass * self.center_of_mass + other.mass * other.center_of_mass) / m
        offset = self.center_of_mass - other.center_of_mass
        reduced = self.mass * other.mass / m
        tensor = self.inertia + other.inertia + _steiner(reduced, offset)
        return self._derived((m, c, tensor), physical, changing_parts, poses)

    def __add__(self, other: object) -> SpatialInertia:
        if not isinstance(other, SpatialInertia):
            raise OperationError(
                f"+ expects another SpatialInertia, got {other!r}.\n"
                "  fix: functools.reduce(operator.add, bodies) in place of sum(bodies), which starts with 0"
            )
        return self.merge(other)

    def __radd__(self, other: object) -> SpatialInertia:
        return self if other is None else self + other  # None: the body of a link without mass

    @property
    def _centered(self) -> bool:
        return isinstance(self.center_of_mass, Constant) and not self.center_of_mass.value.any()

    def _velocity_of_center(self, v: Expr, w: Expr) -> Expr:
        """v + w x c."""
        return v if self._centered else v + Cross(w, self.center_of_mass)

    def _with_arm(self, torque: Expr, force: Expr) -> Expr:
        """torque + c x force."""
        return torque if self._centered else torque + Cross(self.center_of_mass, force)


def power(F: ExprLike, V: ExprLike) -> Expr:
    """The power $F . V$ (), W, of a wrench F (6,) on a body with twist V (6,), both expressed in the same frame. It is
    the same in every frame.

    Raises: ShapeError if an argument is not of shape (6,).
    """
    return Dot(of_shape("power", "F", F, (6,)), of_shape("power", "V", V, (6,)))


def positive_definite(tensor: np.ndarray) -> bool:
    """Whether all principal moments are finite, and positive beyond round-off."""
    if not np.isfinite(tensor).all():
        return False
    return bool(np.linalg.eigvalsh(tensor)[0] > _ROUND_OFF * np.max(np.abs(tensor)))


def _velocities(owner: str, V: ExprLike) -> tuple[Expr, Expr]:
    twist = of_shape(owner, "V", V, (6,))
    return linear(twist), angular(twist)


def _steiner(m: Expr, c: Expr) -> Expr:
    """The parallel-axis term -m [c]x [c]x = m (|c|^2 I - c c^T) of a mass at distance c."""
    return m * (Dot(c, c) * np.eye(3) - Outer(c, c))


def _parts_of(mass: ExprLike, center_of_mass: ExprLike, inertia: ExprLike) -> tuple[Expr, Expr, Expr]:
    body, diagonal = "SpatialInertia", "principal moments go in as np.diag([Ixx, Iyy, Izz])"
    return (
        of_shape(body, "mass", mass, (), unit=kilograms),
        of_shape(body, "center_of_mass", center_of_mass, (3,), unit=metres),
        of_shape(body, "inertia", inertia, (3, 3), diagonal, unit=kilograms * metres**2),
    )


def _known(expr: Expr) -> np.ndarray | None:
    """The number or array of an expression: that of a Constant, or the value of a Parameter."""
    return expr.value if isinstance(expr, (Constant, Parameter)) else None


def _need(holds: Any, demand: str) -> None:
    if not holds:
        raise ModelError(f"SpatialInertia expects {demand}")


def _check(mass: np.ndarray | None, center: np.ndarray | None, tensor: np.ndarray | None) -> None:
    """Raise ModelError if known numbers cannot be the inertia of a real body."""
    if mass is not None:
        _need(np.isfinite(mass) and mass > 0.0, f"a positive, finite mass in kg, got {mass}")
    if center is not None:
        _need(np.isfinite(center).all(), f"a finite center_of_mass in m, got {center.tolist()}")
    if tensor is None:
        return
    _need(np.isfinite(tensor).all(), f"a finite inertia in kg m2, got\n{tensor}")
    slack = _ROUND_OFF * np.max(np.abs(tensor))
    _need(
        np.max(np.abs(tensor - tensor.T)) <= slack,
        f"a symmetric inertia, got\n{tensor}\n"
        "  fix: enter both halves; if the source gives products of inertia, the entries off the diagonal are their "
        "negatives",
    )
    small, middle, large = moments = np.linalg.eigvalsh(tensor).tolist()
    fix = "  fix: give the tensor about the centre of mass, or use SpatialInertia.about_origin; check signs"
    _need(small >= -slack, f"principal moments that are not negative, got {moments} kg m2.\n{fix} and units")
    _need(
        large <= small + middle + slack,
        "principal moments none of which is above the sum of the other two (no body has such), "
        f"got {moments} kg m2.\n{fix}, units;\n  of a flat body, round the largest moment down",
    )
