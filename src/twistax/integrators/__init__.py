"""Integration on groups: methods, controls, events, solutions. Tableaus are `tx.tableaus`, charts `tx.charts`."""

from .commutator_free import CommutatorFree
from .controls import FirstOrderHold, PiecewisePolynomial, ZeroOrderHold
from .events import AtStart, Event
from .implicit_rkmk import ImplicitRKMK
from .integrate import integrate
from .magnus import Magnus
from .method import Method, VectorField
from .rkmk import RKMK
from .run import Result
from .solution import Solution
from .step_control import StepControl
