"""Signed distances between solids."""
