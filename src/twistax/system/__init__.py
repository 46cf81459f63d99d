"""Systems, and their compiled form: calls, Jacobians, Hessians, explanations, files, other languages."""

from .declared import name_of, need_finite
from .system import System, entry_names, free_name

__all__ = ["System", "entry_names", "free_name", "name_of", "need_finite"]
