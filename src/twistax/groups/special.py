"""SO(3) and SE(3) as groups of states, and the two orders of a twist. All maps of this package work linear first."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from types import ModuleType
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from twistax.errors import InputError, ModelError, ShapeError
from twistax.groups import quaternions, se3, so3
from twistax.groups.annotations import Array, Float
from twistax.groups.arrays import (
    Input,
    compiled,
    defect,
    dot,
    element,
    element_defect,
    floats,
    matrix,
    of_shape,
    unpack,
)
from twistax.groups.group import ElementPart, Group


@dataclass(frozen=True, repr=False)
class Order:
    """The order of the parts of a six-vector: [v; w] or [w; v]. Use the two instances LINEAR_FIRST and ANGULAR_FIRST.

    It applies to six-vectors (twists, wrenches, momenta, tangents) and 6x6 matrices, not to the 4x4 pose.
    """

    linear_leads: bool

    def __repr__(self) -> str:
        return "LINEAR_FIRST" if self.linear_leads else "ANGULAR_FIRST"

    def split(self, xi: Input) -> tuple[Float[Array, "3 *k"], Float[Array, "3 *k"]]:
        """(v, w): linear and angular part of a six-vector in this order, or of k columns (6, k). Raises ShapeError."""
        (xi,) = floats(xi)
        (xi,) = of_shape("Order.split", {"xi": (6, *_columns(xi))}, xi)
        return (xi[:3], xi[3:]) if self.linear_leads else (xi[3:], xi[:3])

    def join(self, v: Input, w: Input) -> Float[Array, "6 *k"]:
        """The six-vector of a linear part v and an angular part w in this order, or k columns. Raises ShapeError."""
        v, w = floats(v, w)
        part = (3, *_columns(v))
        v, w = of_shape("Order.join", {"v": part, "w": part}, v, w)
        return jnp.concatenate([v, w] if self.linear_leads else [w, v])

    def from_linear_first(self, a: Input) -> Float[Array, "*shape"]:
        """A linear-first vector (6,) or matrix (6, 6), both axes, converted to this order. Raises ShapeError."""
        (a,) = floats(a)
        if a.shape not in ((6,), (6, 6)):
            raise ShapeError(f"Order expects a with shape (6,) or (6, 6), got {a.shape}")
        return a if self.linear_leads else jnp.roll(a, 3, axis=tuple(range(a.ndim)))

    def to_linear_first(self, a: Input) -> Float[Array, "*shape"]:
        """A vector (6,) or matrix (6, 6) in this order converted to linear first. Swapping the halves is its own
        inverse.
        """
        return self.from_linear_first(a)


def _columns(a: Array) -> tuple[int, ...]:
    return a.shape[1:] if a.ndim == 2 else ()


LINEAR_FIRST = Order(linear_leads=True)
ANGULAR_FIRST = Order(linear_leads=False)


@compiled
def _tightened(R: Array) -> Array:
    """R (3 I - R^T R) / 2: a drift of size e in R^T R - I becomes one of size e^2.

    One Newton step towards the nearest rotation, cheap enough for every step of a long run.
    Source: Higham, Functions of Matrices (2008), ch. 8, the Newton-Schulz iteration.
    """
    entries = unpack(R)
    rows = [entries[i : i + 3] for i in (0, 3, 6)]
    x, y, z = (entries[i::3] for i in range(3))
    xx, yy, zz = (0.5 * (dot(column, column) - 1.0) for column in (x, y, z))
    xy, xz, yz = 0.5 * dot(x, y), 0.5 * dot(x, z), 0.5 * dot(y, z)
    half = ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))
    return matrix([[row[j] - dot(row, half[j]) for j in range(3)] for row in rows])


@compiled
def _nearest(R: Array) -> Array:
    return quaternions.to_rotation(quaternions.unscaled(R))


class _MatrixGroup(Group):
    """Base of both: the maps of a module, which work linear first, on tangents in the group's order."""

    _maps: ClassVar[ModuleType]
    rigid: ClassVar[bool] = True
    remedy: ClassVar[str] = "build it with tx.pose(position=..., euler=... or quaternion=...)"

    def _reordered(self, a: Any) -> Any:
        """To linear first or back, which is the same."""
        return a

    def identity(self, dtype: DTypeLike | None = None) -> Float[Array, "m m"]:
        dtype = jnp.result_type(float) if dtype is None else dtype
        return jnp.asarray(np.eye(self.shape[0], dtype=dtype), dtype)  # of its dtype: nothing to compile

    def exp(self, xi: Input) -> Float[Array, "m m"]:
        return self._maps.exp(self._reordered(xi))

    def log(self, g: Input) -> Float[Array, "n"]:
        return self._reordered(self._maps.log(g))

    def compose(self, g: Input, h: Input) -> Float[Array, "m m"]:
        return self._maps.compose(g, h)

    def inverse(self, g: Input) -> Float[Array, "m m"]:
        return self._maps.inverse(g)

    def Ad(self, g: Input) -> Float[Array, "n n"]:
        return self._reordered(self._maps.Ad(g))

    def ad(self, xi: Input) -> Float[Array, "n n"]:
        return self._reordered(self._maps.ad(self._reordered(xi)))

    def bracket(self, xi: Input, eta: Input) -> Float[Array, "n"]:
        return self._reordered(self._maps.bracket(self._reordered(xi), self._reordered(eta)))

    def left_jacobian(self, xi: Input) -> Float[Array, "n n"]:
        return self._reordered(self._maps.left_jacobian(self._reordered(xi)))

    def left_jacobian_inv(self, xi: Input) -> Float[Array, "n n"]:
        return self._reordered(self._maps.left_jacobian_inv(self._reordered(xi)))

    def right_jacobian_inv_apply(self, eta: Input, omega: Input) -> Float[Array, "n"]:
        moved = self._maps.right_jacobian_inv_apply(self._reordered(eta), self._reordered(omega))
        return self._reordered(moved)

    def entry_rate(self, g: Input, xi: Input) -> Float[Array, "m m"]:
        return self._maps.compose(g, self._maps.hat(self._reordered(xi)))

    def to_linear_first(self, d: Any) -> Any:
        return self._reordered(d)

    known_defect = staticmethod(element_defect)  # type: ignore[assignment]  # by position alone


@dataclass(frozen=True)
class SpecialOrthogonal(_MatrixGroup):
    """SO(3): rotations as (3, 3) matrices, tangents as rotation vectors (3,) in rad. Use the instance SO3."""

    name: ClassVar[str] = "SO3"
    shape: ClassVar[tuple[int, ...]] = (3, 3)
    dimension: ClassVar[int] = 3
    _maps: ClassVar[ModuleType] = so3

    @cached_property
    def parts(self) -> tuple[ElementPart, ...]:
        return (ElementPart("attitude", np.s_[:, :], (0, 1, 2), "rad"),)

    def body_velocity(self, g: Input, rate: Input) -> Float[Array, "3"]:
        """$(R^T R')^v$."""
        g, rate = of_shape("SO3.body_velocity", {"g": self.shape, "rate": self.shape}, g, rate)
        return so3.vee(so3.compose(g.T, rate))

    def normalize(self, g: Input) -> Float[Array, "3 3"]:
        """The rotation nearest to g, up to the square of the drift; orthonormal to round-off."""
        (g,) = of_shape("SO3.normalize", {"g": self.shape}, g)
        return _nearest(element("SO3.normalize", "g", g, np.inf))

    def tighten(self, g: Input) -> Float[Array, "3 3"]:
        """One Newton step towards the nearest rotation."""
        return _tightened(*of_shape("SO3.tighten", {"g": self.shape}, g))

    def defect(self, g: Input) -> Float[Array, ""]:
        """The larger of max |g^T g - I| and |det g - 1|."""
        return defect(*of_shape("SO3.defect", {"g": self.shape}, g))


@dataclass(frozen=True)
class SpecialEuclidean(_MatrixGroup):
    """SE(3): poses as (4, 4) matrices, tangents as twists (6,) in the given order. Use the instance SE3.

    The order concerns tangents, Ad, ad and the Jacobians, never the pose.
    """

    order: Order = LINEAR_FIRST
    shape: ClassVar[tuple[int, ...]] = (4, 4)
    dimension: ClassVar[int] = 6
    _maps: ClassVar[ModuleType] = se3

    @classmethod
    def examples(cls) -> tuple[Group, ...]:
        return cls(), cls(ANGULAR_FIRST)

    @cached_property
    def parts(self) -> tuple[ElementPart, ...]:
        first, last = (0, 1, 2), (3, 4, 5)
        linear, angular = (first, last) if self.order.linear_leads else (last, first)
        return ElementPart("position", np.s_[:3, 3], linear, "m"), ElementPart(
            "attitude", np.s_[:3, :3], angular, "rad"
        )

    def body_velocity(self, g: Input, rate: Input) -> Float[Array, "6"]:
        """$[R^T p'; (R^T R')^v]$, in the order of the group."""
        g, rate = of_shape("SE3.body_velocity", {"g": self.shape, "rate": self.shape}, g, rate)
        back = g[:3, :3].T
        return self.order.join(so3.act(back, rate[:3, 3]), so3.vee(so3.compose(back, rate[:3, :3])))

    @property
    def twist_order(self) -> Order:
        return self.order

    def with_order(self, order: Order) -> SpecialEuclidean:
        """The same group with tangents in another order. Raises ModelError."""
        if not isinstance(order, Order):
            raise ModelError(f"with_order expects tx.LINEAR_FIRST or tx.ANGULAR_FIRST as order, got {order!r}")
        return replace(self, order=order)

    @property
    def name(self) -> str:
        return "SE3" if self.order == LINEAR_FIRST else f"SE3[{self.order!r}]"

    def _reordered(self, a: Any) -> Any:
        return self.order.from_linear_first(a)

    def difference(self, g: Input, h: Input) -> Float[Array, "6"]:
        return self.log(se3.between(g, h))

    def normalize(self, g: Input) -> Float[Array, "4 4"]:
        """The nearest rotation (up to the square of the drift) with the same position, and an exact last row."""
        (g,) = of_shape("SE3.normalize", {"g": self.shape}, g)
        g = element("SE3.normalize", "g", g, np.inf)
        return se3.transform(_nearest(g[:3, :3]), g[:3, 3])

    def tighten(self, g: Input) -> Float[Array, "4 4"]:
        """One Newton step of the rotation towards the nearest one; the position stays."""
        (g,) = of_shape("SE3.tighten", {"g": self.shape}, g)
        return se3.transform(_tightened(g[:3, :3]), g[:3, 3])

    def defect(self, g: Input) -> Float[Array, ""]:
        """The largest of max |R^T R - I|, |det R - 1| and the deviation of the last row from (0, 0, 0, 1)."""
        return defect(*of_shape("SE3.defect", {"g": self.shape}, g))


SO3 = SpecialOrthogonal()
SE3 = SpecialEuclidean()


def tangent_grad(fn: Callable[..., Any], group: Group = SE3, argnums: int = 0) -> Callable[..., jax.Array]:
    """The gradient of a scalar function of a group element: $d/dd fn(g Exp(d))$ at $d = 0$, in reverse mode.

    The ambient gradient of a pose is a 4x4 array with directions that leave the group; this one has the group's
    dimension: (6,) for SE3, in the order of the group, (3,) for SO3. With a Product, g is a dict and the gradient one
    flat vector in the order of declaration (`group.split` splits it).

    Args:
        fn: scalar function; argument number `argnums` is the element, the others are passed unchanged.
        group: the group of the element; for the state of a compiled system `dynamics.group`.
    Returns:
        A function of fn's arguments. It may be jitted, mapped and differentiated again.
    Raises:
        InputError: fn is not a function, or group is not a group; at call time, fewer arguments than argnums needs.
        TypeError: from JAX, if fn is not scalar.
    """

    if not callable(fn):
        raise InputError(f"tangent_grad expects a function of a group element, got {fn!r}")
    if not isinstance(group, Group):
        raise InputError(f"tangent_grad expects a group like tx.SE3 or dynamics.group, got {group!r}")

    def gradient(*args: Any, **kwargs: Any) -> jax.Array:
        if not -len(args) <= argnums < len(args):
            raise InputError(f"tangent_grad expects argument {argnums}, got {len(args)} positional arguments")
        position = argnums % len(args)
        element = args[position]

        def moved(d: jax.Array) -> Any:
            return fn(*args[:position], group.retract(element, d), *args[position + 1 :], **kwargs)

        floating = [leaf.dtype for leaf in jax.tree.leaves(jax.tree.map(jnp.asarray, element))]
        return jax.grad(moved)(jnp.zeros(group.dimension, jnp.result_type(*floating)))

    return gradient
