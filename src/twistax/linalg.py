"""Linear algebra on expressions: `tx.linalg.Solve(M, f)`, `tx.linalg.Norm(v)`, ..."""

from .expr.linalg import Cross, Diag, Dot, Norm, Outer, Sum, Trace, Transpose
from .expr.solve import Inv, Solve

__all__ = ["Cross", "Diag", "Dot", "Inv", "Norm", "Outer", "Solve", "Sum", "Trace", "Transpose"]
