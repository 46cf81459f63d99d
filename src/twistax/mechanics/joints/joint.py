"""What every joint is: states, a pose of the child in the parent, and the screws in the child's frame."""

from __future__ import annotations

import functools
from abc import ABC, abstractmethod
from typing import Any, ClassVar

import numpy as np

from ...errors import ModelError, ShapeError
from ...expr import Constant, Expr, State
from ...expr.fields import ExprLike
from ...groups import Group
from ..arguments import of_shape
from .screws import Screws, complement

#: How far h*^T H may be from the identity.
_ROUND_OFF = 1e-12


class Joint(ABC):
    """A joint between a parent and a child, with k freedoms and a motion subspace H that is constant in the child.

    Subclass it to add one: call `super().__init__` with H, and write `placement`. Six-vectors are [v; w] and [f; tau].

    Args:
        name: begins the names of the states, `<name>_position` and `<name>_velocity`.
        motion: H (6, k), or (6,) for one freedom, in the child's joint frame.
        actuation_basis: h* (6, k) with h*^T H = I; H (H^T H)^-1 unless given. Give it where H mixes m and rad.

    Attributes:
        name: as given.
        dofs: k, from 0 to 6.
        position: the State of shape (k,), or on `group` where a subclass names one; None for k = 0.
        velocity: the State of shape (k,); m/s along slides, rad/s about axes. None for k = 0.
        screws: the three subspaces in the child's joint frame.

    Raises:
        ModelError: no name; H or h* no numbers; H not finite or with dependent columns; h*^T H is not I; a group of
            another dimension.
        ShapeError: H or h* of another shape.
    """

    #: The group of the position; None for k coordinates whose rate is the velocity.
    group: ClassVar[Group | None] = None

    def __init__(self, name: str, motion: Any, actuation_basis: Any = None) -> None:
        if not isinstance(name, str) or not name:
            raise ModelError(f"{type(self).__name__} needs a name: a non-empty string, got {name!r}")
        self.name = name
        H = self._motion(motion)
        self.dofs = H.shape[1]
        if self.group is not None and self.group.dimension != self.dofs:
            raise ModelError(
                f"{self!r} expects a group of dimension {self.dofs}, one for each column of motion, "
                f"got {self.group.name} of dimension {self.group.dimension}"
            )
        h = H @ np.linalg.inv(H.T @ H) if actuation_basis is None else self._actuation(actuation_basis, H)
        self.screws = Screws(Constant(H), Constant(h), Constant(complement(H)))
        self.position: State | None = None
        self.velocity: State | None = None
        if self.dofs:
            shape = (self.dofs,) if self.group is None else None
            self.position = State(f"{name}_position", shape, group=self.group)
            self.velocity = State(f"{name}_velocity", (self.dofs,))

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.name!r})"

    def _columns(self, name: str, value: Any) -> np.ndarray:
        try:
            columns = np.array(value, dtype=np.float64)
        except (TypeError, ValueError):
            raise ModelError(f"{self!r} expects {name} to be an array of numbers, got {value!r}") from None
        return columns[:, None] if columns.ndim == 1 else columns

    def _motion(self, motion: Any) -> np.ndarray:
        H = self._columns("motion", motion)
        if H.ndim != 2 or H.shape[0] != 6 or H.shape[1] > 6:
            raise ShapeError(f"{self!r} expects motion with shape (6, k), k from 0 to 6, got {np.shape(motion)}")
        if not np.isfinite(H).all() or (H.size and np.linalg.matrix_rank(H) < H.shape[1]):
            raise ModelError(
                f"{self!r} expects motion with finite, independent columns, got\n{H}\n"
                "  fix: one column for each freedom, none of them a combination of others"
            )
        return H

    def _actuation(self, basis: Any, H: np.ndarray) -> np.ndarray:
        h = self._columns("actuation_basis", basis)
        if h.shape != H.shape:
            raise ShapeError(f"{self!r} expects actuation_basis with the shape of motion, {H.shape}, got {h.shape}")
        product = h.T @ H
        if not np.allclose(product, np.eye(self.dofs), rtol=0.0, atol=_ROUND_OFF):
            raise ModelError(
                f"{self!r}: actuation_basis must give unit power on the motions, actuation_basis.T @ motion = I, got\n"
                f"{product}\n  fix: leave actuation_basis out, or divide it by this product"
            )
        return h

    @abstractmethod
    def placement(self, position: Expr) -> Expr:
        """T_pc (4, 4) of the position, of shape (0,) where there is none; its rate must be T_pc (H velocity)^."""

    @functools.cached_property
    def transform(self) -> Expr:
        """T_pc (4, 4): maps coordinates of the child's joint frame to the parent's.

        Raises:
            ShapeError: `placement` of a subclass gives another shape.
        """
        position = Constant(np.zeros(0)) if self.position is None else self.position
        return of_shape(repr(self), "its placement", self.placement(position), (4, 4))

    @property
    def rates(self) -> dict[State | str, ExprLike]:
        """The kinematics {position: velocity}, for the rates of a System; empty where nothing moves."""
        return {} if self.position is None or self.velocity is None else {self.position: self.velocity}

    @property
    def twist(self) -> Expr:
        """H @ velocity (6,): the twist of the child relative to the parent, in the child's joint frame."""
        return Constant(np.zeros(6)) if self.velocity is None else self.screws.motion_subspace @ self.velocity

    @property
    def motion_subspace(self) -> Expr:
        """H (6, k) in the child's joint frame."""
        return self.screws.motion_subspace

    @property
    def actuation_basis(self) -> Expr:
        """h* (6, k) in the child's joint frame, h*^T H = I."""
        return self.screws.actuation_basis

    @property
    def constraint_basis(self) -> Expr:
        """H-bar* (6, 6 - k) in the child's joint frame, H^T H-bar* = 0."""
        return self.screws.constraint_basis

    def actuation(self, F: ExprLike) -> Expr:
        """H^T F (k,): the generalised force of a wrench F (6,) on the child. Raises ShapeError."""
        return self.screws.actuation(F)

    def reaction(self, F: ExprLike) -> Expr:
        """F - h* (H^T F) (6,): what the bearing carries of a wrench F (6,). Raises ShapeError."""
        return self.screws.reaction(F)

    def wrench(self, tau: ExprLike) -> Expr:
        """h* tau (6,): the wrench on the child of an actuator with generalised force tau (k,). Raises ShapeError."""
        return self.screws.wrench(tau)

    def screws_in(self, T: ExprLike) -> Screws:
        """The subspaces in another frame; T (4, 4) maps child joint coordinates to that frame. Raises ShapeError."""
        return self.screws.in_frame(T)
