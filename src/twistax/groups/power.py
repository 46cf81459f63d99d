"""Several elements of one group on a leading axis, such as the states of a fleet."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
from jax.typing import DTypeLike

from twistax.checks import whole
from twistax.errors import ModelError
from twistax.groups.annotations import Array, Float
from twistax.groups.arrays import Input, of_shape
from twistax.groups.group import ElementPart, Group


@dataclass(frozen=True)
class GroupPower(Group):
    """The direct product of a group with itself: $G^n$. Maps act on all copies in one operation.

    An element is an array (n, *shape) of elements of the group; a tangent contains the n tangents successively, (n d,).

    Attributes:
        group: the group of each copy, whose elements are arrays.
        count: the number n of copies.
    Raises:
        ModelError: a group whose elements are not arrays, or a count below one.
    """

    group: Group
    count: int

    @classmethod
    def examples(cls) -> tuple[Group, ...]:
        from twistax.groups.special import SE3

        return (cls(SE3, 2),)

    def __post_init__(self) -> None:
        if not isinstance(self.group, Group) or not isinstance(self.group.shape, tuple):
            raise ModelError(f"GroupPower expects a group whose elements are arrays, got {self.group!r}")
        whole("GroupPower: count", self.count, 1, ModelError)

    @property
    def name(self) -> str:
        return f"{self.group.name}^{self.count}"

    @property
    def shape(self) -> tuple[int, ...]:
        return (self.count, *self.group.shape)

    @property
    def dimension(self) -> int:
        return self.count * self.group.dimension

    @cached_property
    def parts(self) -> tuple[ElementPart, ...]:
        d, parts = self.group.dimension, []
        for k in range(self.count):
            for part in self.group.parts:
                place = part.place if isinstance(part.place, tuple) else (part.place,)
                entries = tuple(k * d + entry for entry in part.entries)
                parts.append(ElementPart(f"{part.name} {k}", (k, *place), entries, part.unit))
        return tuple(parts)

    def sizes(self, g: Any) -> Float[Array, "n"]:
        """The sizes of all copies."""
        return jax.vmap(self.group.sizes)(g).reshape(-1)

    def _rows(self, function: str, *tangents: Input) -> list[Array]:
        """Tangents as arrays (n, d). Raises ShapeError."""
        shapes = {f"tangent {k}": (self.dimension,) for k in range(len(tangents))}
        vectors = of_shape(f"{self.name}.{function}", shapes, *tangents)
        return [vector.reshape(self.count, self.group.dimension) for vector in vectors]

    def _diagonal(self, blocks: Array) -> Array:
        """The matrix with the blocks (n, d, d) on its diagonal."""
        eye = jnp.eye(self.count, dtype=blocks.dtype)
        return jnp.einsum("kl,kij->kilj", eye, blocks).reshape(self.dimension, self.dimension)

    def _matrix(self, function: Callable[[Any], Any], rows: Array) -> Array:
        return self._diagonal(jax.vmap(function)(rows))

    def identity(self, dtype: DTypeLike | None = None) -> Any:
        one = self.group.identity(dtype)
        return jnp.broadcast_to(one, (self.count, *one.shape))

    def exp(self, xi: Input) -> Any:
        return jax.vmap(self.group.exp)(*self._rows("exp", xi))

    def log(self, g: Any) -> Float[Array, "n"]:
        return jax.vmap(self.group.log)(g).reshape(-1)

    def compose(self, g: Any, h: Any) -> Any:
        return jax.vmap(self.group.compose)(g, h)

    def inverse(self, g: Any) -> Any:
        return jax.vmap(self.group.inverse)(g)

    def retract(self, g: Any, d: Input) -> Any:
        return jax.vmap(self.group.retract)(g, *self._rows("retract", d))

    def difference(self, g: Any, h: Any) -> Float[Array, "n"]:
        return jax.vmap(self.group.difference)(g, h).reshape(-1)

    def Ad(self, g: Any) -> Float[Array, "n n"]:
        return self._matrix(self.group.Ad, g)

    def ad(self, xi: Input) -> Float[Array, "n n"]:
        return self._matrix(self.group.ad, *self._rows("ad", xi))

    def left_jacobian(self, xi: Input) -> Float[Array, "n n"]:
        return self._matrix(self.group.left_jacobian, *self._rows("left_jacobian", xi))

    def left_jacobian_inv(self, xi: Input) -> Float[Array, "n n"]:
        return self._matrix(self.group.left_jacobian_inv, *self._rows("left_jacobian_inv", xi))

    def right_jacobian_inv_apply(self, eta: Input, omega: Input) -> Float[Array, "n"]:
        rows = self._rows("right_jacobian_inv_apply", eta, omega)
        return jax.vmap(self.group.right_jacobian_inv_apply)(*rows).reshape(-1)

    def normalize(self, g: Any) -> Any:
        return jax.vmap(self.group.normalize)(g)

    def tighten(self, g: Any) -> Any:
        return jax.vmap(self.group.tighten)(g)

    def defect(self, g: Any) -> Float[Array, ""]:
        """The largest defect of a copy."""
        return jnp.max(jax.vmap(self.group.defect)(g))


#: The name of the class in files of earlier versions.
Power = GroupPower
