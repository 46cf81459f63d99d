"""Distances between solids."""
