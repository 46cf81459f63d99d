"""Mechanics in the language: joints, bodies and the environment around them, all of them expressions."""

from . import chain_models, environment, joints
from .bodies import SpatialInertia, power
from .chain import Chain, Link
from .chain_dynamics import aba, forward_dynamics, inverse_dynamics, mass_matrix, rnea

# fmt: off
__all__ = [
    "Chain", "Link", "SpatialInertia", "aba", "chain_models", "environment", "forward_dynamics", "inverse_dynamics",
    "joints", "mass_matrix", "power", "rnea",
]
# fmt: on
