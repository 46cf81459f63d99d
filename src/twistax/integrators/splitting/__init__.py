"""Splitting methods for long runs: exact flows of free motions, and kicks by the forces in between."""

from .body import FreeBody, FreeMotion, FreeParticle
from .compositions import Composition
from .splitting import Splitting
