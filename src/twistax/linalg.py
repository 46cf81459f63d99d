"""Linear algebra on expressions: `tx.linalg.Solve(M, f)`, `tx.linalg.Norm(v)`, ..."""

from .expr.matrices.independent_rows import IndependentRows
from .expr.matrices.linalg import Cross, Diag, Dot, Norm, Outer, Sum, Trace, Transpose
from .expr.matrices.solve import Inv, Solve
from .expr.matrices.solve_positive import InverseFactor, InversePositive, SolvePositive

# fmt: off
__all__ = [
    "Cross", "Diag", "Dot", "IndependentRows", "Inv", "InverseFactor", "InversePositive", "Norm", "Outer", "Solve",
    "SolvePositive", "Sum", "Trace", "Transpose",
]
# fmt: on
