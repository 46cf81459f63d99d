"""Implicit methods: collocation tableaus, the equations of their stages, Newton's method, derivatives."""

from .collocation import CollocationTableau
from .implicit_rkmk import ImplicitRKMK
from .radau_gauss import GAUSS_LEGENDRE4, GAUSS_LEGENDRE6, IMPLICIT, RADAU_IIA3, RADAU_IIA5, RADAU_IIA9

__all__ = [
    "GAUSS_LEGENDRE4",
    "GAUSS_LEGENDRE6",
    "IMPLICIT",
    "RADAU_IIA3",
    "RADAU_IIA5",
    "RADAU_IIA9",
    "CollocationTableau",
    "ImplicitRKMK",
]
