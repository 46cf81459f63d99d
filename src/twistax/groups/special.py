"""SO(3) and SE(3) as groups of states, and the two orders of a twist. All maps of this package work linear first."""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax.numpy as jnp
from jax.typing import DTypeLike
from jaxtyping import Array, Float

from twistax.errors import ShapeError
from twistax.groups import quaternions, se3, so3
from twistax.groups.arrays import Input, cross, dot, floats, multiply, of_shape, unpack
from twistax.groups.group import Group

__all__ = ["ANGULAR_FIRST", "LINEAR_FIRST", "SE3", "SO3", "Order", "SpecialEuclidean", "SpecialOrthogonal"]


@dataclass(frozen=True, repr=False)
class Order:
    """How a six-vector stacks its parts: [v; w] or [w; v]. Use the two instances LINEAR_FIRST and ANGULAR_FIRST.

    It concerns six-vectors (twists, wrenches, momenta, tangents) and 6x6 matrices, never the 4x4 pose.
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
        """A linear-first vector (6,) or matrix (6, 6), both axes, brought into this order. Raises ShapeError."""
        (a,) = floats(a)
        if a.shape not in ((6,), (6, 6)):
            raise ShapeError(f"Order expects a with shape (6,) or (6, 6), got {a.shape}")
        return a if self.linear_leads else jnp.roll(a, 3, axis=tuple(range(a.ndim)))

    def to_linear_first(self, a: Input) -> Float[Array, "*shape"]:
        """A vector (6,) or matrix (6, 6) in this order brought to linear first. Swapping the halves undoes itself."""
        return self.from_linear_first(a)


def _columns(a: Array) -> tuple[int, ...]:
    return a.shape[1:] if a.ndim == 2 else ()


LINEAR_FIRST = Order(linear_leads=True)
ANGULAR_FIRST = Order(linear_leads=False)


def _nearest(R: Array) -> Array:
    return quaternions.to_rotation(quaternions.unscaled(R))


def _skewness(R: Array) -> Array:
    """The larger of max |R^T R - I| and |det R - 1|, which a reflection fails."""
    x, y, z = (unpack(R[:, i]) for i in range(3))
    return jnp.maximum(
        jnp.max(jnp.abs(multiply(R.T, R) - jnp.eye(3, dtype=R.dtype))), jnp.abs(dot(x, cross(y, z)) - 1.0)
    )


@dataclass(frozen=True)
class SpecialOrthogonal(Group):
    """SO(3): rotations as (3, 3) matrices, tangents as rotation vectors (3,) in rad. Use the instance SO3."""

    @property
    def name(self) -> str:
        return "SO3"

    @property
    def shape(self) -> tuple[int, ...]:
        return (3, 3)

    @property
    def dimension(self) -> int:
        return 3

    def identity(self, dtype: DTypeLike | None = None) -> Float[Array, "3 3"]:
        return jnp.eye(3, dtype=dtype)

    def exp(self, xi: Input) -> Float[Array, "3 3"]:
        return so3.exp(xi)

    def log(self, g: Input) -> Float[Array, "3"]:
        return so3.log(g)

    def compose(self, g: Input, h: Input) -> Float[Array, "3 3"]:
        return so3.compose(g, h)

    def inverse(self, g: Input) -> Float[Array, "3 3"]:
        return so3.inverse(g)

    def Ad(self, g: Input) -> Float[Array, "3 3"]:
        return so3.Ad(g)

    def ad(self, xi: Input) -> Float[Array, "3 3"]:
        return so3.ad(xi)

    def bracket(self, xi: Input, eta: Input) -> Float[Array, "3"]:
        return so3.bracket(xi, eta)

    def left_jacobian(self, xi: Input) -> Float[Array, "3 3"]:
        return so3.left_jacobian(xi)

    def left_jacobian_inv(self, xi: Input) -> Float[Array, "3 3"]:
        return so3.left_jacobian_inv(xi)

    def right_jacobian_inv_apply(self, eta: Input, omega: Input) -> Float[Array, "3"]:
        return so3.right_jacobian_inv_apply(eta, omega)

    def normalize(self, g: Input) -> Float[Array, "3 3"]:
        """The rotation nearest to g, up to the square of the drift; orthonormal to round-off."""
        return _nearest(*of_shape("SO3.normalize", {"g": self.shape}, g))

    def tighten(self, g: Input) -> Float[Array, "3 3"]:
        """One Newton step towards the nearest rotation."""
        return so3.tightened(g)

    def defect(self, g: Input) -> Float[Array, ""]:
        """The larger of max |g^T g - I| and |det g - 1|."""
        return _skewness(*of_shape("SO3.defect", {"g": self.shape}, g))


@dataclass(frozen=True)
class SpecialEuclidean(Group):
    """SE(3): poses as (4, 4) matrices, tangents as twists (6,) in the given order. Use the instance SE3.

    The order concerns tangents, Ad, ad and the Jacobians, never the pose.
    """

    order: Order = LINEAR_FIRST

    def with_order(self, order: Order) -> SpecialEuclidean:
        """The same group with tangents in another order."""
        return replace(self, order=order)

    @property
    def name(self) -> str:
        return "SE3" if self.order == LINEAR_FIRST else f"SE3[{self.order!r}]"

    @property
    def shape(self) -> tuple[int, ...]:
        return (4, 4)

    @property
    def dimension(self) -> int:
        return 6

    def identity(self, dtype: DTypeLike | None = None) -> Float[Array, "4 4"]:
        return jnp.eye(4, dtype=dtype)

    def exp(self, xi: Input) -> Float[Array, "4 4"]:
        return se3.exp(self.order.to_linear_first(xi))

    def log(self, g: Input) -> Float[Array, "6"]:
        return self.order.from_linear_first(se3.log(g))

    def compose(self, g: Input, h: Input) -> Float[Array, "4 4"]:
        return se3.compose(g, h)

    def inverse(self, g: Input) -> Float[Array, "4 4"]:
        return se3.inverse(g)

    def difference(self, g: Input, h: Input) -> Float[Array, "6"]:
        return self.log(se3.between(g, h))

    def Ad(self, g: Input) -> Float[Array, "6 6"]:
        return self.order.from_linear_first(se3.Ad(g))

    def ad(self, xi: Input) -> Float[Array, "6 6"]:
        return self.order.from_linear_first(se3.ad(self.order.to_linear_first(xi)))

    def bracket(self, xi: Input, eta: Input) -> Float[Array, "6"]:
        linear_first = self.order.to_linear_first
        return self.order.from_linear_first(se3.bracket(linear_first(xi), linear_first(eta)))

    def left_jacobian(self, xi: Input) -> Float[Array, "6 6"]:
        return self.order.from_linear_first(se3.left_jacobian(self.order.to_linear_first(xi)))

    def left_jacobian_inv(self, xi: Input) -> Float[Array, "6 6"]:
        return self.order.from_linear_first(se3.left_jacobian_inv(self.order.to_linear_first(xi)))

    def right_jacobian_inv_apply(self, eta: Input, omega: Input) -> Float[Array, "6"]:
        linear_first = self.order.to_linear_first
        return self.order.from_linear_first(se3.right_jacobian_inv_apply(linear_first(eta), linear_first(omega)))

    def normalize(self, g: Input) -> Float[Array, "4 4"]:
        """The nearest rotation (up to the square of the drift) with the same position, and an exact last row."""
        (g,) = of_shape("SE3.normalize", {"g": self.shape}, g)
        return se3.transform(_nearest(g[:3, :3]), g[:3, 3])

    def tighten(self, g: Input) -> Float[Array, "4 4"]:
        """One Newton step of the rotation towards the nearest one; the position stays."""
        (g,) = of_shape("SE3.tighten", {"g": self.shape}, g)
        return se3.transform(so3.tightened(g[:3, :3]), g[:3, 3])

    def defect(self, g: Input) -> Float[Array, ""]:
        """The largest of max |R^T R - I|, |det R - 1| and the deviation of the last row from (0, 0, 0, 1)."""
        (g,) = of_shape("SE3.defect", {"g": self.shape}, g)
        row = jnp.max(jnp.abs(g[3] - jnp.asarray([0.0, 0.0, 0.0, 1.0], dtype=g.dtype)))
        return jnp.maximum(_skewness(g[:3, :3]), row)


SO3 = SpecialOrthogonal()
SE3 = SpecialEuclidean()
