"""Splitting methods for long integrations: exact flows of free motions, alternating with kicks by the forces."""

from .body import FreeBody, FreeMotion, FreeParticle
from .compositions import Composition
from .splitting import Splitting
