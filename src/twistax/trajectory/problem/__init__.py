"""The statement of an optimal-control problem: phases, objective, boundary conditions and path constraints, and its
solve.
"""

from ...expr.moved import earlier_classes

__getattr__ = earlier_classes(__name__)
