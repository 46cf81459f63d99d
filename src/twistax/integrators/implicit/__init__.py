"""Implicit methods: collocation tableaus, the equations of their stages, Newton's method, derivatives."""

from .collocation import CollocationTableau
from .implicit_rkmk import ImplicitRKMK
from .radau_gauss import GAUSS_LEGENDRE4, GAUSS_LEGENDRE6, IMPLICIT, RADAU_IIA3, RADAU_IIA5

__all__ = [
    "GAUSS_LEGENDRE4",
    "GAUSS_LEGENDRE6",
    "IMPLICIT",
    "RADAU_IIA3",
    "RADAU_IIA5",
    "CollocationTableau",
    "ImplicitRKMK",
]
