"""Integration of phases, one after another."""

from .integrate_phases import Phase, integrate_phases
