"""Estimates that use measurements of later times too."""
