"""Direct products of named groups: the joint state of a system."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, pairwise, starmap
from types import MappingProxyType
from typing import Any

import jax.numpy as jnp
from jax.typing import DTypeLike

from twistax.errors import InputError, ModelError, ShapeError
from twistax.groups.annotations import Array, Float
from twistax.groups.arrays import Input, of_shape
from twistax.groups.euclidean import Euclidean
from twistax.groups.group import Group


@dataclass(frozen=True, init=False, repr=False)
class Product(Group):
    """A direct product of named groups, such as $SE(3)^N x SO(3)^K x R^m$.

    An element is a dict name -> element. A tangent is one flat vector whose parts are in the order of declaration (not
    in JAX's order of sorted keys). Factors may be products. Two products are equal if names, groups and order are.
    Raises InputError for a dict with missing or unknown names.
    """

    _factors: tuple[tuple[str, Group], ...]

    @classmethod
    def examples(cls) -> tuple[Group, ...]:
        flat = cls({"y": Euclidean((2, 2)), "x": Euclidean()})
        return flat, cls({"pair": flat, "b": Euclidean((2,))})

    def __init__(self, factors: Mapping[str, Group]) -> None:
        if not isinstance(factors, Mapping):
            raise ModelError(f"Product expects a dict from names to groups, got {type(factors).__name__}")
        for name, group in factors.items():
            if not isinstance(group, Group):
                raise ModelError(f"Product expects a Group for factor {name!r}, got {type(group).__name__}")
        object.__setattr__(self, "_factors", tuple(factors.items()))

    def __repr__(self) -> str:
        return f"Product({dict(self._factors)!r})"

    def __reduce__(self) -> Any:
        return Product, (dict(self._factors),)  # views of dicts, which it keeps, cannot be pickled

    @cached_property
    def factors(self) -> Mapping[str, Group]:
        """name -> Group, in order of declaration."""
        return MappingProxyType(dict(self._factors))

    @cached_property
    def slices(self) -> Mapping[str, slice]:
        """name -> the slice of a tangent vector that belongs to it."""
        ends = list(accumulate((group.dimension for _, group in self._factors), initial=0))
        return MappingProxyType(dict(zip(self.factors, starmap(slice, pairwise(ends)))))

    @property
    def name(self) -> str:
        return " x ".join(group.name for _, group in self._factors) or "R0"

    @property
    def shape(self) -> dict[str, Any]:
        return {name: group.shape for name, group in self._factors}

    @cached_property
    def dimension(self) -> int:
        return sum(group.dimension for _, group in self._factors)

    def split(self, d: Input) -> dict[str, Float[Array, "_"]]:
        """The parts of a tangent vector: name -> (dimension of the factor,). Raises ShapeError."""
        (d,) = of_shape("Product.split", {"d": (self.dimension,)}, d)
        return {name: d[part] for name, part in self.slices.items()}

    def join(self, parts: Any) -> Float[Array, "n"]:
        """The tangent vector of the parts, in any order of the dict. Raises ShapeError and InputError for invalid
        parts.
        """
        self._check_names("join", parts)
        if not parts:
            return jnp.zeros(0)
        names = [name for name, _ in self._factors]
        shapes = {name: (group.dimension,) for name, group in self._factors}
        return jnp.concatenate(of_shape("Product.join", shapes, *(parts[name] for name in names)))

    def _check_names(self, function: str, g: Any) -> None:
        if not isinstance(g, Mapping):
            raise ShapeError(f"Product.{function} expects a dict with the parts of the state, got {type(g).__name__}")
        missing = [name for name, _ in self._factors if name not in g]
        unknown = [name for name in g if name not in self.factors]
        if missing or unknown:
            raise InputError(
                f"Product.{function} expects the names {[name for name, _ in self._factors]}, "
                f"got {list(g)} (missing {missing}, unknown {unknown})"
            )

    def _each(self, function: str, *elements: Any) -> dict[str, Any]:
        """A function of every factor, applied to its parts of the elements."""
        for g in elements:
            self._check_names(function, g)
        return {name: getattr(group, function)(*(g[name] for g in elements)) for name, group in self._factors}

    def _diagonal(self, parts: Mapping[str, Array]) -> Array:
        rows = [
            jnp.pad(block, ((0, 0), (self.slices[name].start, self.dimension - self.slices[name].stop)))
            for name, block in parts.items()
        ]
        return jnp.concatenate(rows, axis=0) if rows else jnp.zeros((0, 0))

    def identity(self, dtype: DTypeLike | None = None) -> dict[str, Any]:
        return {name: group.identity(dtype) for name, group in self._factors}

    def exp(self, xi: Input) -> dict[str, Any]:
        return self._each("exp", self.split(xi))

    def log(self, g: Any) -> Float[Array, "n"]:
        return self.join(self._each("log", g))

    def compose(self, g: Any, h: Any) -> dict[str, Any]:
        return self._each("compose", g, h)

    def inverse(self, g: Any) -> dict[str, Any]:
        return self._each("inverse", g)

    def retract(self, g: Any, d: Input) -> dict[str, Any]:
        return self._each("retract", g, self.split(d))

    def difference(self, g: Any, h: Any) -> Float[Array, "n"]:
        return self.join(self._each("difference", g, h))

    def Ad(self, g: Any) -> Float[Array, "n n"]:
        return self._diagonal(self._each("Ad", g))

    def ad(self, xi: Input) -> Float[Array, "n n"]:
        return self._diagonal(self._each("ad", self.split(xi)))

    def left_jacobian(self, xi: Input) -> Float[Array, "n n"]:
        return self._diagonal(self._each("left_jacobian", self.split(xi)))

    def left_jacobian_inv(self, xi: Input) -> Float[Array, "n n"]:
        return self._diagonal(self._each("left_jacobian_inv", self.split(xi)))

    def right_jacobian_inv_apply(self, eta: Input, omega: Input) -> Float[Array, "n"]:
        return self.join(self._each("right_jacobian_inv_apply", self.split(eta), self.split(omega)))

    def normalize(self, g: Any) -> dict[str, Any]:
        return self._each("normalize", g)

    def tighten(self, g: Any) -> dict[str, Any]:
        return self._each("tighten", g)

    def defect(self, g: Any) -> Float[Array, ""]:
        """The largest defect of a factor."""
        defects = list(self._each("defect", g).values())
        return jnp.max(jnp.stack(defects)) if defects else jnp.zeros(())
