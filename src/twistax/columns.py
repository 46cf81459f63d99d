"""Tables of solutions: their columns, units, and the representation of rotations."""

from .groups.columns import Column, Layout
from .integrators.results.table_export import EULER, MATRIX, QUATERNION, Columns, Rotations

__all__ = ["EULER", "MATRIX", "QUATERNION", "Column", "Columns", "Layout", "Rotations"]
