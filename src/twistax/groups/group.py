"""What every group of states offers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

from jax.typing import DTypeLike
from jaxtyping import Array, Float

from twistax.groups.inputs import Input, multiply, of_shape

__all__ = ["Group"]


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

    @abstractmethod
    def right_jacobian(self, xi: Input) -> Float[Array, "n n"]:
        """J_r with Exp(xi + d) = Exp(xi) Exp(J_r d) to first order."""

    @abstractmethod
    def right_jacobian_inv(self, xi: Input) -> Float[Array, "n n"]:
        """The inverse of J_r(xi)."""

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
        """The d with g (+) d = h: Log(g^-1 h)."""
        return self.log(self.compose(self.inverse(g), h))
