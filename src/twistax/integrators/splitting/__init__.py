"""Splitting methods for long runs: free motions flown exactly, and kicks by the forces in between."""

from .body import FreeBody
from .composition import Composition
from .motion import FreeMotion
from .particle import FreeParticle
from .splitting import Splitting

__all__ = ["Composition", "FreeBody", "FreeMotion", "FreeParticle", "Splitting"]
