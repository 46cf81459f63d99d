"""All that take part, in the order of tables. The first that has a task is what others must agree with."""

from __future__ import annotations

from .contender import Contender
from .own import Arrays, Native, Scalars
from .peers.casadi import Casadi
from .peers.openscvx import OpenScvx
from .peers.pinocchio import Pinocchio
from .peers.plain_jax import PlainJax

__all__ = ["BASES", "CONTENDERS"]

CONTENDERS: tuple[Contender, ...] = (
    Scalars(),
    Native(),
    Arrays(),
    PlainJax(),
    OpenScvx(),
    Casadi(),
    Pinocchio(),
)

#: Ratios are to these.
BASES = (PlainJax.name, Casadi.name)
