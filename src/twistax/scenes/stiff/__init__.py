"""Scenes with rates that die away much faster than the motion."""
