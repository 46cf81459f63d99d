"""Mechanics in the language: joints, bodies and the environment around them, all of them expressions."""

from . import chain_models as chain_models
from . import environment as environment
from . import joints as joints
from .bodies import SpatialInertia as SpatialInertia
from .bodies import power as power
from .chain import Chain as Chain
from .chain import Link as Link
from .chain_dynamics import aba as aba
from .chain_dynamics import forward_dynamics as forward_dynamics
from .chain_dynamics import inverse_dynamics as inverse_dynamics
from .chain_dynamics import mass_matrix as mass_matrix
from .chain_dynamics import rnea as rnea
