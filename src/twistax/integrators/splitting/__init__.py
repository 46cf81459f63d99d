"""Splitting methods for long runs: exact flows of free motions, and kicks by the forces in between."""

from .body import FreeBody, FreeParticle
from .compositions import Composition
from .motion import FreeMotion
from .splitting import Splitting

__all__ = ["Composition", "FreeBody", "FreeMotion", "FreeParticle", "Splitting"]
