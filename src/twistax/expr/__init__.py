"""The expression language: leaves, nodes, constraints, and what walks over them."""

from . import lie as lie
from .arithmetic import Add, Constraint, Div, Equality, Inequality, MatMul, Mul, Neg, Power, Sub
from .array import Block, Concat, Hstack, Index, Stack, Vstack
from .canonical import canonicalize_all as canonicalize_all
from .choice import All, Any, Cond, LogSumExp, Max, Min, Where
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
from .graph import evaluate_all as evaluate_all
from .graph import find_path as find_path
from .graph import leaves_of as leaves_of
from .graph import postorder as postorder
from .graph import substitute as substitute
from .graph import traverse
from .interpolation import Bilerp, Cinterp, Linterp
from .leaves import Constant, Control, Leaf, Parameter, State, Time, Variable
from .leaves import Inputs as Inputs
from .linalg import Cross, Diag, Dot, Norm, Outer, Sum, Trace, Transpose  # noqa: F401  in tx.linalg
from .node import Example, Expr, to_expr
from .node import all_nodes as all_nodes
from .orders import check_orders as check_orders
from .solve import Inv, Solve  # noqa: F401  in tx.linalg
from .spatial import QDCM, SSM, SSMP, QuaternionProduct  # noqa: F401  in tx.spatial
from .vmap import Vmap

#: What `twistax` itself offers; the rest is in its faces, or for the layers above.
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
    "Div",
    "Equality",
    "Example",
    "Exp",
    "Expr",
    "Hstack",
    "Huber",
    "Index",
    "Inequality",
    "Leaf",
    "Linterp",
    "Log",
    "LogSumExp",
    "MatMul",
    "Max",
    "Min",
    "Mul",
    "Neg",
    "Parameter",
    "PositivePart",
    "Power",
    "Sign",
    "Sin",
    "Sinh",
    "SmoothReLU",
    "Sqrt",
    "Square",
    "Stack",
    "State",
    "Sub",
    "Tan",
    "Tanh",
    "Time",
    "Variable",
    "Vmap",
    "Vstack",
    "Where",
    "to_expr",
    "traverse",
]
