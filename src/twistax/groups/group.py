"""What every group of states offers; R^m, and products of groups."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, pairwise, starmap
from math import prod
from types import MappingProxyType
from typing import Any

import jax.numpy as jnp
from jax.typing import DTypeLike
from jaxtyping import Array, Float

from twistax.errors import InputError, ModelError, ShapeError
from twistax.groups.arrays import Input, floats, multiply, of_shape


class Group(ABC):
    """A Lie group of states with right perturbations: g (+) d = g Exp(d), and rates in the body frame, g' = g hat(xi).

    An element is an array of shape `shape` (for a Product a dict of them), a tangent a vector (dimension,). Groups are
    values: frozen, hashable, equal when they mean the same. A new group subclasses this and defines the abstract
    members; the rest follows from them.
    """

    @property
    @abstractmethod
    def name(self) -> str:
        """How messages call the group."""

    @property
    @abstractmethod
    def shape(self) -> Any:
        """The shape of an element: a tuple, for a Product a dict of shapes."""

    @property
    @abstractmethod
    def dimension(self) -> int:
        """The length of a tangent vector."""

    @abstractmethod
    def identity(self, dtype: DTypeLike | None = None) -> Any:
        """The neutral element, in the default precision unless told otherwise."""

    @abstractmethod
    def exp(self, xi: Input) -> Any:
        """Exp: tangent -> element."""

    @abstractmethod
    def log(self, g: Any) -> Float[Array, "n"]:
        """Log: element -> tangent, the inverse of exp near the identity."""

    @abstractmethod
    def compose(self, g: Any, h: Any) -> Any:
        """g h."""

    @abstractmethod
    def inverse(self, g: Any) -> Any:
        """g^-1."""

    @abstractmethod
    def Ad(self, g: Any) -> Float[Array, "n n"]:
        """The matrix of xi -> (g hat(xi) g^-1)^v."""

    @abstractmethod
    def ad(self, xi: Input) -> Float[Array, "n n"]:
        """The matrix of eta -> [xi, eta]."""

    def bracket(self, xi: Input, eta: Input) -> Float[Array, "n"]:
        """[xi, eta] = ad_xi eta. Raises ShapeError."""
        n = (self.dimension,)
        xi, eta = of_shape(f"{self.name}.bracket", {"xi": n, "eta": n}, xi, eta)
        return multiply(self.ad(xi), eta)

    @abstractmethod
    def left_jacobian(self, xi: Input) -> Float[Array, "n n"]:
        """J_l with Exp(xi + d) = Exp(J_l d) Exp(xi) to first order."""

    @abstractmethod
    def left_jacobian_inv(self, xi: Input) -> Float[Array, "n n"]:
        """The inverse of J_l(xi)."""

    def right_jacobian(self, xi: Input) -> Float[Array, "n n"]:
        """J_r(xi) = J_l(-xi), with Exp(xi + d) = Exp(xi) Exp(J_r d) to first order."""
        return self.left_jacobian(-floats(xi)[0])

    def right_jacobian_inv(self, xi: Input) -> Float[Array, "n n"]:
        """The inverse of J_r(xi)."""
        return self.left_jacobian_inv(-floats(xi)[0])

    @abstractmethod
    def right_jacobian_inv_apply(self, eta: Input, omega: Input) -> Float[Array, "n"]:
        """J_r(eta)^-1 omega, without building the matrix."""

    @abstractmethod
    def normalize(self, g: Any) -> Any:
        """The element of the group nearest to a slightly drifted g."""

    @abstractmethod
    def defect(self, g: Any) -> Float[Array, ""]:
        """How far g is from the group: the largest absolute violation of its defining equations."""

    def tighten(self, g: Any) -> Any:
        """`normalize` for round-off: cheap enough for every step, and good to the square of the drift."""
        return self.normalize(g)

    def retract(self, g: Any, d: Input) -> Any:
        """g (+) d = g Exp(d)."""
        return self.compose(g, self.exp(d))

    def difference(self, g: Any, h: Any) -> Float[Array, "n"]:
        """The d with $g (+) d = h$: $Log(g^-1 h)$."""
        return self.log(self.compose(self.inverse(g), h))


@dataclass(frozen=True, init=False)
class Euclidean(Group):
    """Arrays of one shape under addition; () and matrices too. The tangent is the array read row by row, (size,).

    `Euclidean(3)` is `Euclidean((3,))`, that is $R^3$. Raises ModelError for anything but a size or a shape.
    """

    shape: tuple[int, ...] = ()

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

    @property
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


class Product(Group):
    """A direct product of named groups, $SE(3)^N x SO(3)^K x R^m$ and the like.

    An element is a dict name -> element, a tangent one flat vector whose parts follow the order of declaration (not
    the sorted keys JAX uses for dicts). Factors may be products themselves. Two products are equal when names, groups
    and order are. Raises InputError for a dict that lacks a name or has one too many.
    """

    def __init__(self, factors: Mapping[str, Group]) -> None:
        if not isinstance(factors, Mapping):
            raise ModelError(f"Product expects a dict from names to groups, got {type(factors).__name__}")
        for name, group in factors.items():
            if not isinstance(group, Group):
                raise ModelError(f"Product expects a Group for factor {name!r}, got {type(group).__name__}")
        self._factors = tuple(factors.items())

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Product) and self._factors == other._factors

    def __hash__(self) -> int:
        return hash(self._factors)

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

    @property
    def dimension(self) -> int:
        return sum(group.dimension for _, group in self._factors)

    def split(self, d: Input) -> dict[str, Float[Array, "_"]]:
        """A tangent vector taken apart: name -> (dimension of the factor,). Raises ShapeError."""
        (d,) = of_shape("Product.split", {"d": (self.dimension,)}, d)
        return {name: d[part] for name, part in self.slices.items()}

    def join(self, parts: Any) -> Float[Array, "n"]:
        """The tangent vector made of the parts, whatever their order in the dict. Raises ShapeError, InputError."""
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
        """The function of every factor applied to its parts of the elements."""
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
