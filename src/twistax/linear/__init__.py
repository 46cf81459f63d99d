"""Linearisation and discretisation of a compiled system in the tangent space, and the modes of a linear system."""

from .discretize import Discretization, discretize
from .linearize import Linearization, linearize
from .modes import Mode

__all__ = ["Discretization", "Linearization", "Mode", "discretize", "linearize"]
