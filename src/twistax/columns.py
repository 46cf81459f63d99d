"""Tables of solutions: which columns, with which units, and how rotations are written."""

from .integrators.columns import EULER, MATRIX, QUATERNION, Column, Columns, Layout, Rotations

__all__ = ["EULER", "MATRIX", "QUATERNION", "Column", "Columns", "Layout", "Rotations"]
