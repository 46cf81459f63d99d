"""Stiff scenes: with rates that decay much faster than the motion."""
