"""Integration by diffrax: Lie-group steps in its loops, and systems as plain ODEs for its solvers.

term, solver = tx.diffrax.lie_term(dynamics), tx.diffrax.LieSolver(diffrax.Tsit5(), dynamics)
term = tx.diffrax.ambient_term(dynamics)  # quaternions as plain numbers, for any solver
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import diffrax
import equinox as eqx

from .integrators.ambient import AmbientSystem
from .integrators.diffrax_bridge import LieController, LieSolver, LieTerm, controller, lie_term
from .system.dynamics import Arrays, Dynamics

__all__ = ["AmbientTerm", "LieController", "LieSolver", "LieTerm", "ambient_term", "controller", "lie_term"]


class AmbientTerm(diffrax.ODETerm):
    """A `diffrax.ODETerm` with conversions of states to arrays of numbers and back."""

    ambient: AmbientSystem = eqx.field(static=True)

    def __init__(self, ambient: AmbientSystem) -> None:
        self.ambient = ambient
        self.vector_field = ambient.vector_field

    def to_ambient(self, x: Mapping[str, Any]) -> Arrays:
        """The y0 of a state. Raises the errors of a call of the dynamics."""
        return self.ambient.to_ambient(x)

    def from_ambient(self, y: Mapping[str, Any]) -> Arrays:
        """The state of one y. Use jax.vmap for saved times."""
        return self.ambient.from_ambient(y)


def ambient_term(dynamics: Dynamics, quaternion: bool = True) -> AmbientTerm:
    """The system as a plain ODE $y' = f(t, y, args)$ with args = (u, params), in the form of `tx.integrate`, or None.

        term = tx.diffrax.ambient_term(dynamics)
        sol = diffrax.diffeqsolve(term, diffrax.Dopri8(), 0.0, 10.0, 0.01, term.to_ambient(x0), args=(u, params))
        xs = jax.vmap(term.from_ambient)(sol.ys)

    y is a dict by state name: poses are [quaternion, position] (7,), rotations quaternions (4,), w first. With
    quaternion=False both are matrices, which drift from the group by the solver's error. Other states are unchanged.

    Raises:
        ModelError: a state on a group that has no such representation.
    """
    return AmbientTerm(AmbientSystem(dynamics, quaternion))
