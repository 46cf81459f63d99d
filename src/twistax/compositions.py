"""Symmetric compositions for `tx.Splitting`: `tx.compositions.KAHAN_LI8` and others; a custom one is a
`Composition`.
"""

from .integrators.splitting.compositions import *  # noqa: F403
from .integrators.splitting.compositions import __all__ as _compositions

__all__ = [*_compositions]
