"""The expression language: leaves, nodes, constraints, and what walks over them."""

from . import lie
from .arithmetic import (
    Add,
    Constraint,
    Div,
    Equality,
    Inequality,
    Less,
    MatMul,
    Mul,
    Neg,
    Power,
    Sub,
    refuse_conditions,
)
from .array import Block, Concat, Hstack, Index, Stack, Vstack
from .canonical import canonicalize_all
from .choice import All, Any, Cond, LogSumExp, Max, Min, Not, Where
from .elementwise import (
    Abs,
    Acos,
    Asin,
    Atan,
    Atan2,
    Cos,
    Cosh,
    Exp,
    Huber,
    Log,
    PositivePart,
    Sign,
    Sin,
    Sinh,
    SmoothReLU,
    Sqrt,
    Square,
    Tan,
    Tanh,
)
from .examples import Example
from .graph import evaluate_all, find_path, leaves_of, postorder, substitute, traverse
from .independent_rows import IndependentRows
from .interpolation import Bilerp, Cinterp, Interp, Linterp
from .leaves import Constant, Control, Inputs, Leaf, Parameter, State, Time, Variable
from .linalg import Cross, Diag, Dot, Norm, Outer, Sum, Trace, Transpose
from .node import Expr, all_nodes, to_expr
from .orders import check_orders
from .rate import Rate
from .soft import Soft
from .solve import Inv, Solve
from .solve_positive import InverseFactor, InversePositive, SolvePositive
from .spatial import QDCM, SSM, SSMP, Quaternion, QuaternionProduct
from .vmap import Vmap

#: What `twistax` itself offers; the rest is in its faces, or for the layers above.
# fmt: off
__all__ = [
    "Abs", "Acos", "Add", "All", "Any", "Asin", "Atan", "Atan2", "Bilerp", "Block", "Cinterp", "Concat", "Cond",
    "Constant", "Constraint", "Control", "Cos", "Cosh", "Div", "Equality", "Example", "Exp", "Expr", "Hstack", "Huber",
    "Index", "Inequality", "Interp", "Leaf", "Less", "Linterp", "Log", "LogSumExp", "MatMul", "Max", "Min", "Mul",
    "Neg", "Not", "Parameter", "PositivePart", "Power", "Rate", "Sign", "Sin", "Sinh", "SmoothReLU", "Soft", "Sqrt",
    "Square", "Stack", "State", "Sub", "Tan", "Tanh", "Time", "Variable", "Vmap", "Vstack", "Where", "to_expr",
    "traverse",
]
# fmt: on
