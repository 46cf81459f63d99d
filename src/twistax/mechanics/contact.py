"""Contact models: forces at frames as controls within friction cones, for optimal control; and a compliant ground.

A contact point is the origin of a frame, and its Jacobian is that of the frame (`frame_jacobian`). Forces are in the
base's axes. The normal of a level ground is the base's z axis.

Sources: K. Hunt, F. Crossley, Coefficient of restitution interpreted as damping in vibroimpact, Journal of Applied
Mechanics (1975), for the normal force.
"""

from __future__ import annotations

import dataclasses
import functools
import operator
from collections.abc import Callable, Collection, Iterator, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..checks import callable_with, name_list, number, reals, short
from ..errors import ModelError
from ..expr import Concat, Constant, Constraint, Control, Cross, Dot, Expr, Max, Min, Norm, Outer, Sqrt, State, to_expr
from ..expr.fields import ExprLike
from ..expr.functions.function import Function
from ..expr.graph import other_leaves
from ..expr.lie import wrench
from ..system.lower import lower
from ..view import Capsule, Sphere
from .algorithms.dynamics import checked
from .algorithms.jacobians import ALIGNED, frame_twist
from .algorithms.momentum import total_mass
from .arguments import constant, of_shape, scalar
from .distances.solids import rounded
from .kinematic_tree import KinematicTree, Positions

_Range = tuple[str, Callable[[float], Any]]

_UP = Constant(np.array([0.0, 0.0, 1.0]))
_POSITIVE: _Range = ("a positive number", lambda a: 0.0 < a < np.inf)
_NOT_NEGATIVE: _Range = ("a number not below zero", lambda a: 0.0 <= a < np.inf)

#: Half of the width of the rounded corner between stiction and sliding, as a share of the limit of friction.
_ROUNDED = 0.02


@dataclasses.dataclass(frozen=True)
class GivenForces:
    """Contact forces as decision variables of an optimal control problem. Made by `given_forces`.

    Attributes:
        controls: the Control "force_<frame>" (3,) of each frame, N in the base's axes.
        wrenches: the wrenches of the forces, for `wrenches=` of `system` and of the dynamics.
        cones: the friction cones |f_t| <= mu f_z, by name, for `constraints=` of `system`.
        at_rest: the constraints of zero velocity (3,) of the contact points, m/s, by name.
    """

    controls: dict[str, Control]
    wrenches: dict[str, Expr]
    cones: dict[str, Constraint]
    at_rest: dict[str, Constraint]


def given_forces(mechanism: KinematicTree, frames: Collection[str], friction: ExprLike) -> GivenForces:
    """Contact forces at frames that touch the ground, as controls, with the friction cones and no-slip constraints.

    Args:
        mechanism: a tree or a chain.
        frames: names of the frames; the contact points are their origins.
        friction: the friction coefficient mu, not negative: a number, or a scalar expression such as a Parameter.
    Raises: ModelError: an unknown frame; a friction that is neither a number nor a scalar expression, or negative.
    """
    checked("given_forces", mechanism)
    scalar("given_forces", "friction", friction, *_NOT_NEGATIVE)
    contact = GivenForces({}, {}, {}, {})
    for name in name_list("given_forces: frames", frames, ModelError):
        f, velocity = Control(f"force_{name}", (3,)), frame_twist(mechanism, name, axes=ALIGNED)[:3]
        contact.controls[name], contact.wrenches[name] = f, _Point(mechanism.pose(name), None, velocity).wrench(f)
        contact.cones[f"friction of {name}"] = Norm(f[:2]) <= friction * f[2]
        contact.at_rest[f"rest of {name}"] = velocity == np.zeros(3)
    return contact


@dataclasses.dataclass(frozen=True)
class Bristles:
    """Contacts with stiction, as arguments of `system`. Made by `Ground.bristles`.

    Attributes:
        rates: the rate of the State "bristle_<frame>" of each frame, for `rates=`. The state has two entries for each
            point that touches the ground: (2,) for the origin of a frame and for a ball, (4,) for a capsule. They are
            the deflection in m along two tangents of the ground; start at zero for a contact at rest.
        wrenches: the contact wrenches, for `wrenches=`.
    """

    rates: dict[State, Expr]
    wrenches: dict[str, Expr]


@dataclasses.dataclass(frozen=True)
class Ground:
    r"""A compliant ground: a smooth contact force on every point below it, and almost none on points above it.

    Let d be the penetration depth of a point, and $s(d) = (d + sqrt(d^2 + sharpness^2)) / 2$ a smooth max(d, 0). The
    normal force is $n = stiffness s(d) g(1 + damping d')$, with g a smooth max(., 0). The friction force is $-mu n v /
    sqrt(|v|^2 + slip^2)$, with the tangential velocity v. The equations are stiff: integrate them with
    `tx.ImplicitRKMK` and a Radau tableau. Over a height field h(x, y), d is the depth below the tangent plane at the
    ground above or below the point, $d = (h - z) / sqrt(1 + |h'|^2)$, which is exact if the ground is plane within the
    distance d. The normal force on a point acts along -dd/dp: it has the potential $stiffness \int s \, dd$ without
    damping, so a point gains no energy on curved ground.

    Each attribute is a number or a scalar expression, such as a Parameter: other values do not recompile, and
    `jax.vmap` maps over them.

    Attributes:
        stiffness: normal force per depth, N/m, positive.
        damping: s/m, not negative: the factor of the penetration rate in the normal force (Hunt and Crossley).
        friction: friction coefficient mu, not negative.
        height: the height z of the ground in the base, m: constant, or a function that maps the expressions x and y, m,
            to an expression, such as `lambda x, y: tx.Interp(x, y, axes=axes, values=heights,
            kind=tx.tables.BSpline())`.
        sharpness: m, positive: the height over the ground at which the force begins.
        slip: m/s, positive: the sliding speed at which friction reaches 71 % of mu n.
    Raises: ModelError for numbers out of their range, or a height that is not a scalar expression of x and y;
        ShapeError for an attribute that is not a scalar.
    Example: `robot.system(wrenches=Ground(stiffness=2e4, friction=0.8).wrenches(robot, ["foot"]))`.
    """

    stiffness: ExprLike = 2e4
    damping: ExprLike = 0.5
    friction: ExprLike = 0.8
    height: Any = 0.0
    sharpness: ExprLike = 1e-4
    slip: ExprLike = 0.01

    def __post_init__(self) -> None:
        for name in ("stiffness", "sharpness", "slip"):
            scalar("Ground", name, getattr(self, name), *_POSITIVE)
        for name in ("damping", "friction"):
            scalar("Ground", name, getattr(self, name), *_NOT_NEGATIVE)
        if callable(self.height):
            callable_with("Ground: height", self.height, ["x", "y"], ModelError)
        else:
            constant("Ground", "height", scalar("Ground", "height", self.height))

    def force(self, place: Expr, velocity: Expr) -> Expr:
        """The force (3,), N, on a point at `place` (3,) with the velocity `velocity` (3,), in the axes of the base."""
        velocity = of_shape("Ground.force", "velocity", velocity, (3,))
        normal, up = self._push(place, velocity)
        across = _across(up)
        v = across @ velocity
        speed = Sqrt(Dot(v, v) + to_expr(self.slip) ** 2)
        return normal * (up - across.T @ (self.friction * v / speed))

    def normal(self, place: Expr, velocity: Expr) -> Expr:
        """The normal force n (), N, on a point at `place` (3,) with the velocity `velocity` (3,), in the axes of the
        base.
        """
        return self._push(place, of_shape("Ground.normal", "velocity", velocity, (3,)))[0]

    def upward(self, place: Expr) -> Expr:
        """The unit normal (3,) of the ground above or below a place (3,), in the axes of the base."""
        place = of_shape("Ground.upward", "place", place, (3,))
        if not callable(self.height):
            return _UP
        slope = Function(jax.grad(self._height()), (2,), name="slope")(place[:2])
        return Concat(-slope, 1.0) / Sqrt(1.0 + Dot(slope, slope))

    def _push(self, place: Expr, velocity: Expr) -> tuple[Expr, Expr]:
        """The normal force n (), N, on a point, and its direction (3,)."""
        depth, up = self._surface(of_shape("Ground", "place", place, (3,)))
        damping_factor = _positive(1.0 - to_expr(self.damping) * Dot(velocity, up), 1e-3)
        size = to_expr(self.stiffness) * _positive(depth, self.sharpness) * damping_factor
        return (size, up) if up is _UP else (size * Norm(up), up / Norm(up))

    def _surface(self, place: Expr) -> tuple[Expr, Expr]:
        """The depth d () of a place (3,) below the tangent plane of the ground there, and -dd/dp (3,)."""
        if not callable(self.height):
            return self.height - place[2], _UP
        height = self._height()

        def depth(p: jax.Array) -> jax.Array:
            h, slope = jax.value_and_grad(height)(p[:2])
            return (h - p[2]) / jnp.sqrt(1.0 + slope @ slope)

        at = jax.value_and_grad(depth)
        field = Function(lambda p: jnp.concatenate([jnp.ravel(a) for a in at(p)]), (4,), name="ground")(place)
        return field[0], -field[1:]

    def _height(self) -> Callable[[jax.Array], jax.Array]:
        """The height as a function of [x, y]."""
        xy = State("xy", (2,))
        value = self.height(xy[0], xy[1])
        surface = value if isinstance(value, Expr) else to_expr(reals("Ground: height", value, ModelError))
        inputs = [leaf for leaf in other_leaves(surface, [xy]) if not isinstance(leaf, Constant)]
        if surface.check_shape() != () or surface.boolean or inputs:
            raise ModelError(f"Ground: height expects a scalar expression of x and y alone, got {short(surface)}")
        lowered = lower(surface)
        return lambda p: lowered(0.0, {"xy": p})

    def bristles(
        self,
        mechanism: KinematicTree,
        frames: Collection[str] | Mapping[str, Sphere | Capsule],
        deflection: float = 1e-3,
        damping: float = 20.0,
        load: float | None = None,
    ) -> Bristles:
        r"""Friction with stiction at points of frames: a point under a force within the friction cone remains at rest.

        Each contact is a spring with a damper, the bristle, in series with a Coulomb slider. The state z (2,), m, is
        the deflection of the bristle, v (2,) the tangential velocity, n the normal force, $n_0$ the load. The stiffness
        $k = \mu n_0 / d$ and the damping constant $c = \mu n_0 \sigma$ do not depend on n, only the limit $\mu n$ of
        the slider does. The friction force and the rate of the bristle are

        $f = -p\,y, \qquad \dot z = p\,v - (1 - p) k z / c, \qquad y = k z + c v, \qquad p = \min(1, \mu n / |y|).$

        **Stiction**: for $|y| \le 0.98\,\mu n$ p is one, $\dot z = v$, and the slider does not move, also if forces
        oscillate. A point at rest under the force F is displaced by the elastic deflection $F / k$, that is d for $F =
        \mu n_0$. **Sliding**: at constant velocity $|f| = \mu n$ and $|z| = d\,n / n_0$. Without contact the bristle
        relaxes with the time constant $\sigma d$. The minimum is rounded between 0.98 and 1.02, so that the force has
        continuous first derivatives.

        **Tangents**: z and v are coordinates along the axes x and y of the base after the smallest rotation that turns
        the z axis into the normal of the ground. On level ground they are x and y.

        **Start of a slide**: a bristle that starts at zero is bent first, under a smaller force than $\mu n$. So a body
        that slides from rest is faster by a constant than by Coulomb's law, by 7 mm/s for $\mu = 0.3$ on a slope of 40
        degrees with the default values. A bristle that starts at $|z| = d\,n / n_0$ along the slip velocity avoids it.

        **Passivity**: for any n(t) the power that the point supplies is stored or dissipated, with the storage function
        $k |z|^2 / 2$. Proof: $-f = k z + c \dot z$ by the definitions, and the slider moves with the velocity $v - \dot
        z = (1 - p) y / c$. Hence

        $-f \cdot v = \frac{d}{dt} \frac{k |z|^2}{2} + c |\dot z|^2 + p (1 - p) |y|^2 / c,$

        where the last two terms are not negative because $0 \le p \le 1$. A stiffness $\mu n / d$, as in the LuGre
        model with a force proportional to n, has no such storage function, and feeds the rocking of bodies.

        Args:
            mechanism: a tree or a chain.
            frames: names of the frames whose origins touch the ground, or a dict from names to a `tx.view.Sphere` or a
                `Capsule`, as for `wrenches`.
            deflection: d, m, positive: the deflection of a contact with the load that begins to slide.
            damping: sigma, s/m, positive. 2 / sqrt(mu g d) is the critical damping of a block under its weight.
            load: n_0, N, positive: a typical normal force of one point. By default the weight of the mechanism
                divided by the number of points.
        Raises: ModelError: an unknown frame, a shape that is not supported, a ground without friction, a friction that
            depends on time or states, no load without gravity, or invalid numbers.
        Sources: P. Dupont, V. Hayward, B. Armstrong, F. Altpeter, Single state elastoplastic friction models, IEEE
            Transactions on Automatic Control 47 (2002), for the bristle without creep; L. Romano, O. M. Aamo, J.
            Aslund, E. Frisk, First-order friction models with bristle dynamics, arXiv:2602.09429 (2026), for the rate
            from the friction law of the slider.
        Example:
            grip = Ground(friction=0.5).bristles(walker, ["foot"])
            standing = walker.system(controls=[], rates=grip.rates, wrenches=grip.wrenches)
        """
        for what, value in (("deflection", deflection), ("damping", damping), ("load", 1.0 if load is None else load)):
            number(f"Ground.bristles: {what}", value, *_POSITIVE, ModelError)
        friction = constant("Ground.bristles", "friction", to_expr(self.friction))
        if isinstance(friction, Constant) and not friction.value:
            raise ModelError("Ground.bristles expects a ground with friction, got friction=0.0.\n  fix: use wrenches")
        gravity = checked("Ground.bristles", mechanism).gravity
        if load is None and isinstance(gravity, Constant) and not gravity.value.any():
            raise ModelError("Ground.bristles expects gravity or a load, got neither.\n  fix: pass load=, N")
        shapes = _shapes("Ground.bristles", frames)
        points = {name: list(self._points("Ground.bristles", mechanism, name, s)) for name, s in shapes.items()}
        count = max(sum(map(len, points.values())), 1)
        share = total_mass(mechanism) * Norm(gravity) / count if load is None else to_expr(float(load))
        k, c = friction * share / deflection, friction * share * damping
        result = Bristles({}, {})
        for name, touching in points.items():
            state, rates, wrenches = State(f"bristle_{name}", (2 * len(touching),)), [], []
            for i, point in enumerate(touching):
                normal, up = self._push(point.place, point.velocity)
                across = _across(up)
                z, v = state[2 * i : 2 * i + 2], across @ point.velocity
                y = k * z + c * v
                # A part of the load keeps the limit positive where the normal force rounds to zero.
                stuck = _stuck(y, friction * (normal + 1e-9 * share))
                rates.append(stuck * v - (1.0 - stuck) * z / (damping * deflection))
                wrenches.append(point.wrench(normal * up + across.T @ (-stuck * y)))
            result.rates[state] = Concat(*rates)
            result.wrenches[name] = functools.reduce(operator.add, wrenches)
        return result

    def wrenches(
        self,
        mechanism: KinematicTree,
        frames: Collection[str] | Mapping[str, Sphere | Capsule],
        q: Positions | None = None,
        qd: ExprLike | None = None,
    ) -> dict[str, Expr]:
        """The wrenches of the ground on frames, for `wrenches=` of `system` and of the dynamics.

        Args:
            frames: names of the frames whose origins touch the ground; or a dict from names to the shape that touches
                it, a `tx.view.Sphere` or a `Capsule`. A capsule touches the ground with the balls at its two ends. A
                ball touches a height field along the normal at the point that is nearest if the ground is plane below
                its centre. On ground with the radius of curvature rho the error of the normal's angle is of the order
                $(radius / rho)^2$.
        Raises: ModelError for an unknown frame, or a shape that is not supported; ShapeError for positions of another
            shape.
        """
        wrenches: dict[str, Expr] = {}
        for name, shape in _shapes("Ground.wrenches", frames).items():
            points = self._points("Ground.wrenches", mechanism, name, shape, q, qd)
            wrenches[name] = functools.reduce(
                operator.add, [point.wrench(self.force(point.place, point.velocity)) for point in points]
            )
        return wrenches

    def _points(
        self,
        owner: str,
        mechanism: KinematicTree,
        name: str,
        shape: Sphere | Capsule | None,
        q: Positions | None = None,
        qd: ExprLike | None = None,
    ) -> Iterator[_Point]:
        """The points of a frame that touch the ground."""
        twist, T = frame_twist(mechanism, name, q, qd, axes=ALIGNED), mechanism.pose(name, q)
        if shape is None:
            yield _Point(T, None, twist[:3])
            return
        if not isinstance(shape, (Sphere, Capsule)):
            raise ModelError(f"{owner} expects a Sphere or a Capsule, got {short(shape)}")
        ball = rounded(owner, shape)
        for centre in ball.corners @ ball.at[:3, :3].T + ball.at[:3, 3]:
            arm = T[:3, :3] @ centre
            middle = T[:3, 3] + arm
            # At the normal of the ground at its contact point: at that of its centre f would turn it.
            lowest = middle - ball.radius * self.upward(middle)
            arm = arm - ball.radius * self.upward(lowest)
            yield _Point(T, arm, twist[:3] + Cross(twist[3:], arm))


@dataclasses.dataclass(frozen=True)
class _Point:
    """A point of a frame that touches the ground, in the axes of the base.

    Attributes:
        T: the pose (4, 4) of the frame.
        arm: the point (3,) from the origin of the frame; None for the origin.
        velocity: (3,).
    """

    T: Expr
    arm: Expr | None
    velocity: Expr

    @property
    def place(self) -> Expr:
        """The position (3,) in the base."""
        origin = self.T[:3, 3]
        return origin if self.arm is None else origin + self.arm

    def wrench(self, f: Expr) -> Expr:
        """The wrench (6,), in the axes of the frame, of a force (3,) at the point."""
        R = self.T[:3, :3]
        return wrench(force=R.T @ f, torque=np.zeros(3) if self.arm is None else R.T @ Cross(self.arm, f))


def _shapes(owner: str, frames: Any) -> Mapping[str, Any]:
    """The shape of each frame that touches the ground; None for its origin."""
    return frames if isinstance(frames, Mapping) else dict.fromkeys(name_list(f"{owner}: frames", frames, ModelError))


def _across(up: Expr) -> Expr:
    """Two orthonormal tangents (2, 3) of the ground with the normal n: the axes x and y after the smallest rotation
    from z to n.
    """
    if isinstance(up, Constant):
        return Constant(np.eye(3)[:2])
    share = 1.0 / (1.0 + up[2])
    return Constant(np.eye(3)[:2]) - Outer(up[:2], Concat(up[:2] * share, 1.0))


def _positive(a: Expr, width: ExprLike) -> Expr:
    """(a + sqrt(a^2 + width^2)) / 2."""
    return 0.5 * (a + Sqrt(a * a + to_expr(width) ** 2))


def _stuck(y: Expr, limit: Expr) -> Expr:
    """min(1, limit / |y|) with continuous first derivatives: p such that p |y| is a parabola between its two lines."""
    low, high = (1.0 - _ROUNDED) * limit, (1.0 + _ROUNDED) * limit
    size = Sqrt(Max(Dot(y, y), low * low))
    bend = Min(size, high) - low
    return 1.0 - (bend * bend / (4.0 * _ROUNDED * limit) + Max(size - high, 0.0)) / size
