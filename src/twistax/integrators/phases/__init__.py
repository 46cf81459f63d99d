"""Integration of successive phases."""

from .integrate_phases import Phase, integrate_phases
