"""Tables of solutions: which columns, with which units, and how rotations are written."""

from .groups.columns import Column, Layout
from .integrators.results.table_export import EULER, MATRIX, QUATERNION, Columns, Rotations

__all__ = ["EULER", "MATRIX", "QUATERNION", "Column", "Columns", "Layout", "Rotations"]
