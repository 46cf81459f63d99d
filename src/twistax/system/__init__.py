"""Systems, and their compiled form: calls, Jacobians, Hessians, explanations, files, other languages."""

from .finite import need_finite
from .system import System, entry_names, free_name, name_of

__all__ = ["System", "entry_names", "free_name", "name_of", "need_finite"]
