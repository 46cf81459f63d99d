"""The interface of groups of states."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from twistax.errors import ModelError
from twistax.groups.annotations import Array, Float
from twistax.groups.arrays import Input, floats, multiply, of_shape


@dataclass(frozen=True)
class ElementPart:
    """A part of the elements of a group that has a separate unit, such as the position of a pose.

    A part may be free at an end of a trajectory, is measured in its unit, and has separate table columns and curves.

    Attributes:
        name: its name in results.
        place: its location in an element, as a NumPy index.
        entries: the entries of a tangent d that change it: in g Exp(d) the other entries leave the part unchanged.
        unit: "rad" for angles, "" for plain numbers: their changes are compared with 1. For "m" or any other unit,
            changes are compared with the size of the part. A part in rad of shape (3, 3) is a rotation matrix.
    """

    name: str
    place: Any
    entries: tuple[int, ...]
    unit: str = ""

    def of(self, values: Any) -> Any:
        """This part (n, ...) of elements (n, *shape)."""
        return values[(slice(None), *np.index_exp[self.place])]

    @property
    def sized(self) -> bool:
        """Whether changes are compared with the size of the part, not with 1."""
        return self.unit not in ("", "rad")


class Group(ABC):
    """A Lie group of states with right perturbations: g (+) d = g Exp(d), and rates in the body frame, g' = g hat(xi).

    An element is an array of shape `shape` (for a Product a dict of arrays), and a tangent is a vector (dimension,).
    Groups are values: frozen, hashable, equal if they have the same meaning. To define a group, subclass this and
    define the abstract members; the others follow from them. `tx.testing.check_group` checks a group.
    """

    #: Whether elements are arrays under addition, whose tangents have the shape of the elements.
    flat: ClassVar[bool] = False
    #: Whether elements are rotations (3, 3) or poses (4, 4), which the nodes of `tx.lie` accept.
    rigid: ClassVar[bool] = False
    #: The remedy in error messages: how to make an element.
    remedy: ClassVar[str] = "take the nearest element, that which normalize of the group gives"

    @classmethod
    def examples(cls) -> tuple[Group, ...]:
        """Instances of this class for test suites of all groups; by default the instance without arguments."""
        return (cls(),)

    @property
    @abstractmethod
    def name(self) -> str:
        """The name of the group in messages."""

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
        """The neutral element, by default in JAX's default precision."""

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
        """The Lie bracket [xi, eta] = ad_xi eta. Raises ShapeError for other shapes."""
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

    def right_jacobian_inv_apply(self, eta: Input, omega: Input) -> Float[Array, "n"]:
        """$J_r(eta)^-1 omega$; override it if a formula without the matrix exists. Raises ShapeError for other
        shapes.
        """
        n = (self.dimension,)
        eta, omega = of_shape(f"{self.name}.right_jacobian_inv_apply", {"eta": n, "omega": n}, eta, omega)
        return multiply(self.right_jacobian_inv(eta), omega)

    @abstractmethod
    def normalize(self, g: Any) -> Any:
        """The element of the group nearest to a slightly drifted g."""

    @abstractmethod
    def defect(self, g: Any) -> Float[Array, ""]:
        """The distance of g from the group: the largest absolute violation of its defining equations."""

    def tighten(self, g: Any) -> Any:
        """A cheap `normalize` against round-off, applied once in every step; the remaining error is the square of the
        drift.
        """
        return self.normalize(g)

    def retract(self, g: Any, d: Input) -> Any:
        """g (+) d = g Exp(d)."""
        return self.compose(g, self.exp(d))

    def difference(self, g: Any, h: Any) -> Float[Array, "n"]:
        """The d with $g (+) d = h$: $Log(g^-1 h)$."""
        return self.log(self.compose(self.inverse(g), h))

    # ---- used by states, integrators, problems and tables -----------------------------------------------------------

    @cached_property
    def parts(self) -> tuple[ElementPart, ...]:
        """The parts of an element by unit; each entry of a tangent is in one part. By default one part without a
        unit.
        """
        return (ElementPart("distance", ..., tuple(range(self.dimension))),)

    @cached_property
    def tangent_shape(self) -> tuple[int, ...]:
        """The shape of rates: (dimension,), for flat groups that of the elements."""
        return self.shape if self.flat else (self.dimension,)

    @property
    def angular(self) -> np.ndarray:
        """(dimension,): which entries of a tangent are in rad."""
        return self._where(lambda part: part.unit == "rad")

    @property
    def sized(self) -> np.ndarray:
        """(dimension,): which entries of a tangent are compared with the size of the state, not with 1."""
        return self._where(lambda part: part.sized)

    def _where(self, chosen: Any) -> np.ndarray:
        mask = np.zeros(self.dimension, bool)
        for part in self.parts:
            mask[list(part.entries)] = chosen(part)
        return mask

    def sizes(self, g: Any) -> Float[Array, "n"]:
        """The sizes with which entries of a tangent at g are compared: for a part with a unit of length its length,
        else 1.
        """
        most = jnp.ones(self.dimension, g.dtype)
        for part in self.parts:
            if part.sized:
                most = most.at[np.array(part.entries)].set(_length(g[part.place]))
        return most

    def entry_rate(self, g: Any, xi: Input) -> Any:
        """The rate g hat(xi) of the entries of g, of the shape of g, for the body velocity xi."""
        (xi,) = floats(xi)
        return jax.jvp(lambda d: self.retract(g, d), (jnp.zeros_like(xi),), (xi,))[1]

    def body_velocity(self, g: Any, rate: Any) -> Float[Array, "n"]:
        """The body velocity xi with g hat(xi) = rate; the least-squares solution if the rate is not tangent to the
        group.
        """
        zero = jnp.zeros(self.dimension, jnp.result_type(g))
        columns = jax.jacfwd(lambda d: self.retract(g, d).reshape(-1))(zero)
        return jnp.linalg.solve(multiply(columns.T, columns), multiply(columns.T, rate.reshape(-1)))

    def to_linear_first(self, d: Any) -> Any:
        """A tangent, or numbers for its entries, with the linear part first for groups that support two orders."""
        return d

    @property
    def twist_order(self) -> Any:
        """The order of the entries of a tangent, for groups that have two; None for others."""
        return None

    def with_order(self, order: Any) -> Group:
        """The same group with tangents in another order. Raises ModelError if the group or the order does not support
        it.
        """
        raise ModelError(f"with_order applies to groups of poses, got the group {self.name}")

    def known_defect(self, g: np.ndarray) -> float:
        """`defect` of an array of numbers, in double precision. It can be called inside a JAX trace."""
        from twistax.jax_inside import in_double  # which loads what the language alone does not need

        with in_double():
            return float(self.defect(jnp.asarray(g, float)))


def _length(part: Array) -> Array:
    """The Euclidean length of an array, without over- or underflow of squares; 0 for zeros."""
    most = jnp.max(jnp.abs(part))
    unit = jnp.where(most > 0.0, most, 1.0)
    return most * jnp.sqrt(jnp.sum((part / unit) ** 2))
