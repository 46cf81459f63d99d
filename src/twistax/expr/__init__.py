"""The expression language: leaves, nodes, constraints, and what walks over them."""

from . import lie as lie
from .arithmetic import Add, Div, MatMul, Mul, Neg, Power, Sub
from .array import Concat, Hstack, Stack, Vstack
from .block import Block
from .canonical import canonicalize_all as canonicalize_all
from .constraint import Constraint, Equality, Inequality
from .elementwise import Abs, Exp, Log, Sign, Sqrt, Square
from .extrema import Huber, LogSumExp, Max, Min, PositivePart, SmoothReLU
from .indexing import Index
from .interpolation import Bilerp, Cinterp, Linterp
from .leaves import Constant, Control, Leaf, Parameter, State, Time, Variable
from .leaves import Inputs as Inputs
from .linalg import Cross, Diag, Dot, Norm, Outer, Sum, Trace, Transpose
from .logic import All, Any, Cond, Where
from .node import Example, Expr, to_expr, traverse
from .node import find_path as find_path
from .node import leaves_of as leaves_of
from .node import postorder as postorder
from .node import substitute as substitute
from .orders import check_orders as check_orders
from .registry import all_nodes
from .solve import Inv, Solve
from .spatial import QDCM, SSM, SSMP, QuaternionProduct
from .trigonometry import Acos, Asin, Atan, Atan2, Cos, Cosh, Sin, Sinh, Tan, Tanh
from .vmap import Vmap
from .walk import evaluate_all as evaluate_all

#: What `twistax` itself offers; the floors above also use the walkers imported here.
__all__ = [
    "Abs",
    "Acos",
    "Add",
    "All",
    "Any",
    "Asin",
    "Atan",
    "Atan2",
    "Bilerp",
    "Block",
    "Cinterp",
    "Concat",
    "Cond",
    "Constant",
    "Constraint",
    "Control",
    "Cos",
    "Cosh",
    "Cross",
    "Diag",
    "Div",
    "Dot",
    "Equality",
    "Example",
    "Exp",
    "Expr",
    "Hstack",
    "Huber",
    "Index",
    "Inequality",
    "Inv",
    "Leaf",
    "Linterp",
    "Log",
    "LogSumExp",
    "MatMul",
    "Max",
    "Min",
    "Mul",
    "Neg",
    "Norm",
    "Outer",
    "Parameter",
    "PositivePart",
    "Power",
    "QDCM",
    "QuaternionProduct",
    "SSM",
    "SSMP",
    "Sign",
    "Sin",
    "Sinh",
    "SmoothReLU",
    "Solve",
    "Sqrt",
    "Square",
    "Stack",
    "State",
    "Sub",
    "Sum",
    "Tan",
    "Tanh",
    "Time",
    "Trace",
    "Transpose",
    "Variable",
    "Vmap",
    "Vstack",
    "Where",
    "all_nodes",
    "to_expr",
    "traverse",
]
