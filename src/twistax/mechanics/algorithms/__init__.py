"""Recursions over a kinematic tree, as expressions: dynamics, Jacobians, momentum, derivatives, closed loops."""
