"""Inertial measurement units: noise densities from readings at rest, and preintegration."""
