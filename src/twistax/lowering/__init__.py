"""From trees to functions: one expression (`lower`) or a whole system (`compile`)."""

from .backends import JAX, XLA, Backend
from .dynamics import Dynamics, compile, load
from .explain import Explanation
from .lower import lower
from .native.backend import Native
