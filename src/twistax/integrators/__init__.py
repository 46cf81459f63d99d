"""Integration on groups: methods, controls, events, solutions. Tableaus are `tx.tableaus`, charts `tx.charts`."""

from .controls import FirstOrderHold, PiecewisePolynomial, ZeroOrderHold
from .events.conditions import AtStart, Event
from .integrate import integrate
from .loop.outcome import Result
from .loop.rollout import ended_well
from .method import Method, VectorField
from .methods.commutator_free import CommutatorFree
from .methods.implicit_rkmk import ImplicitRKMK
from .methods.interpolant import Between
from .methods.magnus import Magnus
from .methods.rkmk import RKMK
from .phases.integrate_phases import Phase, integrate_phases
from .phases.phased_solution import PhasedSolution
from .results.solution import Crossings, Solution
from .simulator import Simulator, simulator
from .splitting import FreeBody, FreeParticle, Splitting
from .step_control import StepControl
