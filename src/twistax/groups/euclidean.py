"""R^m and arrays of any shape, as a group under addition."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import prod
from typing import Any, ClassVar

import jax.numpy as jnp
from jax.typing import DTypeLike

from twistax.errors import ModelError
from twistax.groups.annotations import Array, Float
from twistax.groups.arrays import Input, floats, of_shape
from twistax.groups.group import Group


@dataclass(frozen=True, init=False)
class Euclidean(Group):
    """Arrays of one shape under addition, including scalars () and matrices. The tangent is the array read row by row,
    (size,).

    `Euclidean(3)` is `Euclidean((3,))`, that is $R^3$. Raises ModelError for an argument that is not a size or a shape.
    """

    shape: tuple[int, ...] = ()
    flat: ClassVar[bool] = True

    @classmethod
    def examples(cls) -> tuple[Group, ...]:
        return cls(), cls(3), cls((2, 2))

    def __init__(self, shape: Any = ()) -> None:
        sizes = (shape,) if isinstance(shape, int) else shape
        if not isinstance(sizes, tuple) or not all(isinstance(n, int) and n >= 0 for n in sizes):
            raise ModelError(
                f"Euclidean expects a size or a shape of sizes >= 0, got {shape!r}\n"
                "  fix: write Euclidean(3) or Euclidean((3, 2))"
            )
        object.__setattr__(self, "shape", sizes)

    @property
    def name(self) -> str:
        return f"R{self.dimension}" if len(self.shape) == 1 else f"R{self.shape}"

    @cached_property
    def dimension(self) -> int:
        return prod(self.shape)

    def _tangent(self, function: str, xi: Input) -> Array:
        return of_shape(f"{self.name}.{function}", {"xi": (self.dimension,)}, xi)[0]

    def _element(self, function: str, g: Input) -> Array:
        return of_shape(f"{self.name}.{function}", {"g": self.shape}, g)[0]

    def _unit(self, function: str, xi: Input) -> Array:
        return jnp.eye(self.dimension, dtype=self._tangent(function, xi).dtype)

    def identity(self, dtype: DTypeLike | None = None) -> Float[Array, "*shape"]:
        return jnp.zeros(self.shape, dtype)

    def exp(self, xi: Input) -> Float[Array, "*shape"]:
        return self._tangent("exp", xi).reshape(self.shape)

    def log(self, g: Input) -> Float[Array, "n"]:
        return self._element("log", g).reshape(self.dimension)

    def compose(self, g: Input, h: Input) -> Float[Array, "*shape"]:
        g, h = of_shape(f"{self.name}.compose", {"g": self.shape, "h": self.shape}, g, h)
        return g + h

    def inverse(self, g: Input) -> Float[Array, "*shape"]:
        return -self._element("inverse", g)

    def Ad(self, g: Input) -> Float[Array, "n n"]:
        return jnp.eye(self.dimension, dtype=self._element("Ad", g).dtype)

    def ad(self, xi: Input) -> Float[Array, "n n"]:
        return jnp.zeros((self.dimension, self.dimension), self._tangent("ad", xi).dtype)

    def left_jacobian(self, xi: Input) -> Float[Array, "n n"]:
        return self._unit("left_jacobian", xi)

    def left_jacobian_inv(self, xi: Input) -> Float[Array, "n n"]:
        return self._unit("left_jacobian_inv", xi)

    def right_jacobian_inv_apply(self, eta: Input, omega: Input) -> Float[Array, "n"]:
        n = (self.dimension,)
        return of_shape(f"{self.name}.right_jacobian_inv_apply", {"eta": n, "omega": n}, eta, omega)[1]

    def normalize(self, g: Input) -> Float[Array, "*shape"]:
        return self._element("normalize", g)

    def defect(self, g: Input) -> Float[Array, ""]:
        """Zero: every array is an element."""
        return jnp.zeros((), self._element("defect", g).dtype)

    def sizes(self, g: Input) -> Float[Array, "n"]:
        """The absolute values of the entries."""
        return jnp.abs(self.log(g))

    def entry_rate(self, g: Input, xi: Input) -> Float[Array, "*shape"]:
        """The rate itself."""
        return floats(xi)[0].reshape(self.shape)

    def body_velocity(self, g: Input, rate: Input) -> Float[Array, "n"]:
        """The rate itself."""
        return self.log(rate)
