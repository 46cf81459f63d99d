"""The fields of a node class.

class Adjoint(Expr):
    twist1: Operand                    a child; numbers and arrays become Constants
    operands: Operands                 any number of children, positional
    order: Order = LINEAR_FIRST        anything else is static data, part of the structural key
"""

from .declaring import freeze, positive
from .node import ExprLike, Operand, Operands

__all__ = ["ExprLike", "Operand", "Operands", "freeze", "positive"]
