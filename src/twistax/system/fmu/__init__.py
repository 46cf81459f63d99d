"""Compiled systems as functional mock-up units, FMI 3.0."""
