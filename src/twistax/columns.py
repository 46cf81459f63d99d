"""Tables of solutions: which columns, with which units, and how rotations are written."""

from .integrators.results.table_export import EULER, MATRIX, QUATERNION, Columns, Rotations
from .layout import Column, Layout

__all__ = ["EULER", "MATRIX", "QUATERNION", "Column", "Columns", "Layout", "Rotations"]
