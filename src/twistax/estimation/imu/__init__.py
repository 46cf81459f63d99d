"""Inertial measurement units: noise from readings at rest, and preintegrated motion."""
