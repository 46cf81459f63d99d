"""Trajectory problems with known optima: the sections of `python -m twistax report --optimal`."""
