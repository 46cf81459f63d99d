"""Mechanics in the language: joints, bodies and the environment around them, all of them expressions."""

from . import environment as environment
from . import joints as joints
from .bodies import SpatialInertia as SpatialInertia
from .bodies import power as power
