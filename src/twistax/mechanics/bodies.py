"""Rigid bodies: their spatial inertia, and what follows from it as expressions.

Six-vectors are [v; w], [f; tau] and [p; L] about the origin of the body's frame, in its axes.

Source: R. Featherstone, Rigid Body Dynamics Algorithms (2008), chapter 2, for [w; v].
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import ModelError, OperationError
from ..expr import Block, Constant, Cross, Dot, Expr, Outer, Parameter, Solve, canonicalize_all
from ..expr.fields import ExprLike
from ..expr.lie import Act, Hat, angular, linear, wrench
from ..expr.lie import twist as join
from ..units import kilograms, metres
from .arguments import of_shape, pose

#: How far, relative to the largest entry, an inertia tensor may be from symmetric, positive and triangular.
_ROUND_OFF = 1e-9


class SpatialInertia:
    """Mass, centre of mass and inertia tensor of a rigid body, described in one frame fixed to it.

    NOTE: `inertia` is taken about the CENTRE OF MASS, in the axes of the frame. For a tensor about the frame's origin
    use `SpatialInertia.about_origin`.

    Each of the three is a number, an array, or an expression. Numbers, arrays and the default values of Parameters are
    checked to belong to a real body; what depends on states is the user's business. Points and thin rods, whose tensor
    is only semi-definite, are bodies: they can be merged with others. Only `acceleration` refuses them.

    Args:
        mass: kg, ().
        center_of_mass: m, (3,), in the frame; its origin unless given.
        inertia: kg m2, (3, 3), about the centre of mass.
        physical: False takes numbers that no body has as they are.

    Raises:
        ShapeError: a value of another shape.
        ModelError: a mass that is not positive; an entry that is not finite; a tensor that is not symmetric, has a
            negative principal moment, or one above the sum of the other two.
    """

    def __init__(
        self,
        *,
        mass: ExprLike,
        center_of_mass: ExprLike = (0.0, 0.0, 0.0),
        inertia: ExprLike,
        physical: bool = True,
    ) -> None:
        self.mass, self.center_of_mass, self.inertia = _parts_of(mass, center_of_mass, inertia)
        self.physical = physical
        if physical:
            _check(_known(self.mass), _known(self.center_of_mass), _known(self.inertia))

    @classmethod
    def about_origin(cls, *, mass: ExprLike, center_of_mass: ExprLike, inertia: ExprLike) -> SpatialInertia:
        """The body whose `inertia` (3, 3) is given about the frame's ORIGIN, in its axes: $I_c = I_o + m [c]x [c]x$.

        Raises:
            ShapeError, ModelError: as the constructor; a tensor too small for the mass at its distance is unphysical.
        """
        m, c, tensor = _parts_of(mass, center_of_mass, inertia)
        return cls._derived(m, c, tensor - _steiner(m, c))

    @classmethod
    def _derived(cls, mass: Expr, center_of_mass: Expr, inertia: Expr, physical: bool = True) -> SpatialInertia:
        """Constants are folded, so that they are checked and print as numbers."""
        m, c, tensor = canonicalize_all([mass, center_of_mass, inertia])
        return cls(mass=m, center_of_mass=c, inertia=tensor, physical=physical)

    def __repr__(self) -> str:
        return f"SpatialInertia(mass={self.mass!r}, center_of_mass={self.center_of_mass!r}, inertia={self.inertia!r})"

    @property
    def matrix(self) -> Expr:
        """$M = [m I, -m [c]x; m [c]x, I_c - m [c]x [c]x]$ (6, 6)."""
        moment = Hat(self.mass * self.center_of_mass)
        about_origin = self.inertia + _steiner(self.mass, self.center_of_mass)
        return Block([[self.mass * np.eye(3), -moment], [moment, about_origin]])

    def momentum(self, V: ExprLike) -> Expr:
        """$M V = [p; L]$ (6,) of a twist V (6,): $p = m (v + w x c)$, $L = I_c w + c x p$; N s, N m s.

        Raises: ShapeError for an argument of another shape.
        """
        v, w = _velocities("momentum", V)
        p = self.mass * self._velocity_of_center(v, w)
        return wrench(force=p, torque=self._with_arm(self.inertia @ w, p))

    def kinetic_energy(self, V: ExprLike) -> Expr:
        """$(m |v + w x c|^2 + w . I_c w) / 2$ () of a twist V (6,), J. Raises ShapeError."""
        v, w = _velocities("kinetic_energy", V)
        u = self._velocity_of_center(v, w)
        return 0.5 * (self.mass * Dot(u, u) + Dot(w, self.inertia @ w))

    def weight(self, T: ExprLike, gravity: ExprLike) -> Expr:
        """The wrench $[m R^T a; c x m R^T a]$ (6,) of a uniform gravity a, at the body's origin in its axes.

        Args:
            T: the body's pose in the world, (4, 4).
            gravity: a (3,) in world axes, m/s2.
        Raises:
            ShapeError: an argument of another shape.
            ModelError: T is made of numbers and no pose.
        """
        R = pose("weight", "T", T)[:3, :3]
        force = self.mass * (R.T @ of_shape("weight", "gravity", gravity, (3,), "a vector in world axes"))
        return wrench(force=force, torque=self._with_arm(Constant(np.zeros(3)), force))

    def acceleration(self, V: ExprLike, F: ExprLike) -> Expr:
        """$V' = M^-1 (F - ad*_V(M V))$ (6,), Newton and Euler about the centre of mass; no 6x6 matrix is built.

        $w' = I_c^-1 (tau - c x f - w x I_c w)$ and $v' = f/m - w x (v + w x c) - w' x c$. Where the mass burns, F
        contains the thrust, which is what the leaving gas takes along.

        Args:
            V: the body's twist (6,).
            F: the sum of all wrenches on it (6,).
        Raises:
            ShapeError: an argument of another shape.
            ModelError: the inertia tensor is constant and singular.
        """
        tensor = _known(self.inertia)
        if tensor is not None and np.linalg.eigvalsh(tensor)[0] <= _ROUND_OFF * np.max(np.abs(tensor), initial=0.0):
            raise ModelError(
                "acceleration expects an inertia with three positive principal moments, "
                f"got {np.linalg.eigvalsh(tensor).tolist()} kg m2.\n"
                "  fix: merge the point or rod with the rest of the body, or give it a thickness"
            )
        v, w = _velocities("acceleration", V)
        wrench_on_it = of_shape("acceleration", "F", F, (6,))
        f, tau = linear(wrench_on_it), angular(wrench_on_it)
        turning = Solve(self.inertia, self._with_arm(tau, -f) - Cross(w, self.inertia @ w))
        moving = f / self.mass - Cross(w, self._velocity_of_center(v, w))
        return join(linear=self._velocity_of_center(moving, -turning), angular=turning)

    def in_frame(self, T: ExprLike) -> SpatialInertia:
        """The same body described in frame a, T = T_ab (4, 4), b the frame of this one: $M_a = Ad*_T M Ad_T^-1$.

        T must be constant while the body moves: frame a is fixed to the body, too.

        Raises:
            ShapeError: T is not of shape (4, 4).
            ModelError: T is made of numbers and no pose.
        """
        T_ab = pose("in_frame", "T", T)
        R = T_ab[:3, :3]
        return self._derived(self.mass, Act(T_ab, self.center_of_mass), R @ self.inertia @ R.T, self.physical)

    def merge(self, other: SpatialInertia) -> SpatialInertia:
        """Both bodies, rigidly joined, described in one frame; also written `a + b`. Bring them there by `in_frame`.

        Raises: ModelError if other is no SpatialInertia.
        """
        if not isinstance(other, SpatialInertia):
            raise ModelError(f"merge expects another SpatialInertia, got {other!r}")
        physical = self.physical and other.physical
        for body, massless in ((self, other), (other, self)):
            if isinstance(massless.mass, Constant) and not massless.mass.value:  # two of them have no centre
                return self._derived(body.mass, body.center_of_mass, self.inertia + other.inertia, physical)
        m = self.mass + other.mass
        c = (self.mass * self.center_of_mass + other.mass * other.center_of_mass) / m
        apart = self.center_of_mass - other.center_of_mass
        reduced = self.mass * other.mass / m
        tensor = self.inertia + other.inertia + _steiner(reduced, apart)
        return self._derived(m, c, tensor, physical)

    def __add__(self, other: object) -> SpatialInertia:
        if not isinstance(other, SpatialInertia):
            raise OperationError(f"+ expects another SpatialInertia, got {other!r}")
        return self.merge(other)

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
    """$F . V$ (), W, of a wrench (6,) on a body with twist (6,), both in one frame. The same in every frame.

    Raises: ShapeError if an argument is not of shape (6,).
    """
    return Dot(of_shape("power", "F", F, (6,)), of_shape("power", "V", V, (6,)))


def _velocities(owner: str, V: ExprLike) -> tuple[Expr, Expr]:
    twist = of_shape(owner, "V", V, (6,))
    return linear(twist), angular(twist)


def _steiner(m: Expr, c: Expr) -> Expr:
    """-m [c]x [c]x = m (|c|^2 I - c c^T): what a mass adds about a point at distance c."""
    return m * (Dot(c, c) * np.eye(3) - Outer(c, c))


def _parts_of(mass: ExprLike, center_of_mass: ExprLike, inertia: ExprLike) -> tuple[Expr, Expr, Expr]:
    body, diagonal = "SpatialInertia", "principal moments go in as np.diag([Ixx, Iyy, Izz])"
    return (
        of_shape(body, "mass", mass, (), unit=kilograms),
        of_shape(body, "center_of_mass", center_of_mass, (3,), unit=metres),
        of_shape(body, "inertia", inertia, (3, 3), diagonal, unit=kilograms * metres**2),
    )


def _known(expr: Expr) -> np.ndarray | None:
    """The number or array behind an expression: a Constant, or a Parameter with a value."""
    return expr.value if isinstance(expr, (Constant, Parameter)) else None


def _need(holds: Any, demand: str) -> None:
    if not holds:
        raise ModelError(f"SpatialInertia expects {demand}")


def _check(mass: np.ndarray | None, center: np.ndarray | None, tensor: np.ndarray | None) -> None:
    """Raise ModelError for what no real body has, as far as it is known."""
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
