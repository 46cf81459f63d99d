"""Recursive algorithms on kinematic trees, as expressions: dynamics, Jacobians, momentum, derivatives, closed loops."""
