"""The two ways to stack a linear and an angular part. All maps of this package work linear first."""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
from jaxtyping import Array, Float

from twistax.errors import ShapeError
from twistax.groups.inputs import Input, floats, of_shape

__all__ = ["ANGULAR_FIRST", "LINEAR_FIRST", "Order"]


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
