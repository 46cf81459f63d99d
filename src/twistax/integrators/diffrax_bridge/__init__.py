"""Lie-group steps inside diffrax: the term, the solver and the controller of `tx.diffrax`."""

from .frame import LieTerm, lie_term
from .solver import LieController, LieSolver, controller
