"""twistax: dynamics of rigid bodies, written as expressions, compiled to JAX.

    import twistax as tx

    g = tx.State("g", group=tx.SE3)        # pose
    V = tx.State("V", shape=(6,))          # body twist [v; w]
    F = tx.Control("F", shape=(6,))        # body wrench [f; tau]
    M = tx.Parameter("M", shape=(6, 6), value=M0)
    body = tx.System(rates={g: V, V: tx.linalg.Solve(M, F - tx.lie.AdjointDual(V, M @ V))})
    dynamics = tx.compile(body)
    rate = dynamics(0.0, x, u)

Importing changes no global state: precision follows the arrays, and JAX's x64 mode is not changed.
"""

from __future__ import annotations

import difflib
import importlib.util
from typing import TYPE_CHECKING

from . import expr, kinds, lie, linalg, spatial
from .errors import (
    EstimationError,
    ImmutableError,
    InputError,
    IntegrationError,
    KindError,
    ModelError,
    OperationError,
    OrderError,
    ShapeError,
    TrajectoryError,
    TwistaxError,
)
from .expr import *  # noqa: F403  the node classes; expr.__all__ lists them
from .expr import tables
from .expr.lie import pose
from .groups import ANGULAR_FIRST, LINEAR_FIRST, SE3, SO3, Euclidean, Order, Product, tangent_grad
from .kinds import FreeVector, Momentum, Point, Twist, Wrench
from .system import System

if TYPE_CHECKING:  # what `_LATER` loads, for editors and type checkers
    from . import (
        charts,
        columns,
        compositions,
        diffrax,
        estimation,
        mechanics,
        tableaus,
        testing,
        trajectory,
        units,
        view,
    )
    from .estimation import Measurement, fit
    from .expr.functions.function import Function
    from .expr.functions.parameter_tree import ParameterTree
    from .groups.extended.extended_pose import ExtendedPose
    from .integrators import (
        RKMK,
        AtStart,
        Between,
        CommutatorFree,
        Crossings,
        Event,
        FirstOrderHold,
        FreeBody,
        FreeParticle,
        ImplicitRKMK,
        Magnus,
        Phase,
        PhasedSolution,
        PiecewisePolynomial,
        Result,
        Simulator,
        Solution,
        Splitting,
        StepControl,
        ZeroOrderHold,
        integrate,
        integrate_phases,
        simulator,
    )
    from .linear import Mode
    from .monte_carlo import Statistics, Sweep, sweep
    from .scalar.backends import JAX, XLA
    from .scalar.fast import fast
    from .scalar.targets.llvm.backend import Native
    from .system.dynamics import Dynamics, compile, load
    from .system.join import join
    from .system.lower import lower
    from .system.repeat import repeat
    from .trajectory import Maximize, Minimize
    from .trimming import Trim, trim

__version__ = "0.2.0.dev0"

# fmt: off
__all__ = [
    "ANGULAR_FIRST", "LINEAR_FIRST", "RKMK", "SE3", "SO3", "XLA", "JAX", "AtStart", "Between", "CommutatorFree",
    "Crossings", "Dynamics", "EstimationError", "Euclidean", "Event", "ExtendedPose", "FirstOrderHold", "FreeBody",
    "FreeParticle", "FreeVector", "Function", "ImmutableError", "ImplicitRKMK", "InputError", "IntegrationError",
    "KindError", "Magnus", "Maximize", "Measurement", "Minimize", "Mode", "ModelError", "Momentum", "Native",
    "OperationError", "Order", "OrderError", "ParameterTree", "Phase", "PhasedSolution", "PiecewisePolynomial",
    "Point", "Product", "Result", "ShapeError", "Simulator", "Solution", "Splitting", "Statistics", "StepControl",
    "Sweep", "System", "TrajectoryError", "Trim", "Twist", "TwistaxError", "Wrench", "ZeroOrderHold", "charts",
    "columns", "compile", "compositions", "diffrax", "estimation", "fast", "fit", "integrate", "integrate_phases",
    "join", "kinds", "lie", "linalg", "load", "lower", "mechanics", "pose", "repeat", "simulator", "spatial", "sweep",
    "tableaus", "tables", "tangent_grad", "testing", "trajectory", "trim", "units", "view",
]
# fmt: on
__all__ += expr.__all__

#: Loaded when first touched: the language alone is what everybody needs. By the module that has the names.
# fmt: off
_LATER = {
    "": (
        "charts", "columns", "compositions", "diffrax", "estimation", "mechanics", "tableaus", "testing",
        "trajectory", "units", "view",
    ),
    ".estimation": ("Measurement", "fit"),
    ".integrators": (
        "RKMK", "AtStart", "Between", "CommutatorFree", "Crossings", "Event", "FirstOrderHold", "FreeBody",
        "FreeParticle", "ImplicitRKMK", "Magnus", "Phase", "PhasedSolution", "PiecewisePolynomial", "Result",
        "Simulator", "Solution", "Splitting", "StepControl", "ZeroOrderHold", "integrate", "integrate_phases",
        "simulator",
    ),
    ".expr.functions.function": ("Function",),
    ".groups.extended.extended_pose": ("ExtendedPose",),
    ".expr.functions.parameter_tree": ("ParameterTree",),
    ".scalar.backends": ("JAX", "XLA"),
    ".scalar.fast": ("fast",),
    ".scalar.targets.llvm.backend": ("Native",),
    ".system.dynamics": ("Dynamics", "compile", "load"),
    ".system.join": ("join",),
    ".system.lower": ("lower",),
    ".system.repeat": ("repeat",),
    ".monte_carlo": ("Statistics", "Sweep", "sweep"),
    ".linear": ("Mode",),
    ".trajectory": ("Maximize", "Minimize"),
    ".trimming": ("Trim", "trim"),
}
# fmt: on

if not TYPE_CHECKING:  # a type checker shall see the names above and no others

    def __getattr__(name: str):
        for module, names in _LATER.items():
            if name in names:
                with importlib.import_module(__name__ + ".progress").watched("import"):
                    if not module:
                        return importlib.import_module(f"{__name__}.{name}")
                    value = globals()[name] = getattr(importlib.import_module(__name__ + module), name)
                return value
        hint = "" if name.startswith("_") else _where_else(name)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}{hint}")


def _where_else(name: str) -> str:
    """How to mend a name that this module has not: another spelling, another module, or a function of NumPy."""
    # Python asks for a module before it loads it: `from twistax import scenes` loads nothing else.
    if not name.isidentifier():
        return ""
    if importlib.util.find_spec(f"{__name__}.{name}"):
        return f".\n  fix: import {__name__}.{name}"
    known = {public.lower(): public for public in __all__}
    faces = (
        "kinds",
        "lie",
        "linalg",
        "spatial",
        "tables",
        "tableaus",
        "charts",
        "units",
        "trajectory",
        "estimation",
        "mechanics",
        "testing",
    )
    for home in faces:
        for public in importlib.import_module(f"{__name__}.{home}").__all__:
            known.setdefault(public.lower(), f"{home}.{public}")
    if expr.operators.takes_expressions(name.lower()):
        return f".\n  fix: np.{name.lower()}(...) takes expressions"
    near = difflib.get_close_matches(name.lower(), known, 1)
    return f".\n  fix: did you mean tx.{known[near[0]]}?" if near else ""


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
