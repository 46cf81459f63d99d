"""Lie-group steps inside diffrax: the term, the solver and the controller of `tx.diffrax`."""

from .controller import LieController, controller
from .solver import LieSolver
from .term import LieTerm, lie_term

__all__ = ["LieController", "LieSolver", "LieTerm", "controller", "lie_term"]
