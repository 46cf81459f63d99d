"""Implicit methods: collocation tableaus, the equations of their stages, Newton's method, derivatives."""

from .collocation import *  # noqa: F403
from .collocation import __all__ as _tableaus
from .implicit_rkmk import ImplicitRKMK

__all__ = [*_tableaus, "ImplicitRKMK"]
