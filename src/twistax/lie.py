"""`tx.lie`: Lie nodes for expressions, and the numeric maps `tx.lie.so3` and `tx.lie.se3` for plain arrays."""

from .expr.lie import *  # noqa: F403
from .expr.lie import __all__ as _nodes
from .groups import se3, so3

__all__ = [*_nodes, "se3", "so3"]
