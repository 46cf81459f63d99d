"""Linear algebra on expressions: `tx.linalg.Solve(M, f)`, `tx.linalg.Norm(v)`, ..."""

from .expr.independent_rows import IndependentRows
from .expr.linalg import Cross, Diag, Dot, Norm, Outer, Sum, Trace, Transpose
from .expr.solve import Inv, Solve
from .expr.solve_positive import InverseFactor, InversePositive, SolvePositive

# fmt: off
__all__ = [
    "Cross", "Diag", "Dot", "IndependentRows", "Inv", "InverseFactor", "InversePositive", "Norm", "Outer", "Solve",
    "SolvePositive", "Sum", "Trace", "Transpose",
]
# fmt: on
