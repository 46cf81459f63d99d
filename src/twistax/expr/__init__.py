"""The expression language: leaves, nodes and constraints, and functions on expression graphs."""

from . import lie, moved
from .canonical import canonicalize_all
from .examples import Example
from .graph import evaluate_all, find_path, leaves_of, postorder, substitute, traverse
from .kinds.declare import declares
from .leaves import Constant, Control, Inputs, Leaf, Parameter, State, Time, Variable
from .lie.spatial import QDCM, SSM, SSMP, Quaternion, QuaternionProduct
from .matrices.independent_rows import IndependentRows
from .matrices.linalg import Cross, Diag, Dot, Norm, Outer, Sum, Trace, Transpose
from .matrices.solve import Inv, Solve
from .matrices.solve_positive import InverseFactor, InversePositive, SolvePositive
from .node import Expr, all_nodes, to_expr
from .noise import Noise
from .operations.arithmetic import Add, Div, MatMul, Mul, Neg, Power, Sub
from .operations.array import Block, Concat, Hstack, Index, Stack, Vstack
from .operations.choice import All, Any, Cond, LogSumExp, Max, Min, Not, Where
from .operations.comparisons import Constraint, Equality, Inequality, Less, refuse_conditions
from .operations.elementwise import (
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
from .operations.reshaped import Reshaped
from .operations.soft import Soft
from .orders import check_orders
from .tables.interpolation import Bilerp, Cinterp, Interp, Linterp
from .transformations.rate import Rate
from .transformations.vmap import Vmap

#: What `twistax` itself offers; the rest is in its faces, or for the layers above.
# fmt: off
__all__ = [
    "Abs", "Acos", "Add", "All", "Any", "Asin", "Atan", "Atan2", "Bilerp", "Block", "Cinterp", "Concat", "Cond",
    "Constant", "Constraint", "Control", "Cos", "Cosh", "Div", "Equality", "Example", "Exp", "Expr", "Hstack", "Huber",
    "Index", "Inequality", "Interp", "Leaf", "Less", "Linterp", "Log", "LogSumExp", "MatMul", "Max", "Min", "Mul",
    "Neg", "Noise", "Not", "Parameter", "PositivePart", "Power", "Rate", "Sign", "Sin", "Sinh", "SmoothReLU", "Soft",
    "Sqrt", "Square", "Stack", "State", "Sub", "Tan", "Tanh", "Time", "Variable", "Vmap", "Vstack", "Where", "to_expr",
    "traverse",
]
# fmt: on

moved.find_earlier_names()
