"""twistax: dynamics of rigid bodies, written as expressions, compiled to JAX.

    import twistax as tx

    g = tx.State("g", group=tx.SE3)        # pose
    V = tx.State("V", shape=(6,))          # body twist [v; w]
    F = tx.Control("F", shape=(6,))        # body wrench [f; tau]
    M = tx.Parameter("M", shape=(6, 6), value=M0)
    body = tx.System(rates={g: V, V: tx.linalg.Solve(M, F - tx.lie.AdjointDual(V, M @ V))})
    dynamics = tx.compile(body)
    rate = dynamics(0.0, x, u)

Importing changes no global state: precision follows the arrays given, and x64 is yours to switch on.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from . import charts, compositions, expr, lie, linalg, spatial, tableaus
from .errors import (
    ImmutableError,
    InputError,
    IntegrationError,
    ModelError,
    OrderError,
    ShapeError,
    TrajectoryError,
    TwistaxError,
)
from .expr import *  # noqa: F403  the node classes; expr.__all__ lists them
from .groups import ANGULAR_FIRST, LINEAR_FIRST, SE3, SO3, Euclidean, Order, Product, pose, tangent_grad
from .integrators import (
    RKMK,
    CommutatorFree,
    Event,
    FirstOrderHold,
    Magnus,
    Result,
    Solution,
    StepControl,
    ZeroOrderHold,
    integrate,
)
from .integrators.implicit import ImplicitRKMK
from .integrators.splitting import FreeBody, FreeParticle, Splitting
from .lowering import JAX, XLA, Dynamics, Native, compile, load, lower
from .system import System

if TYPE_CHECKING:
    from . import diffrax, mechanics, trajectory
    from .trajectory import Maximize, Minimize

__version__ = "0.1.0"

__all__ = [
    "ANGULAR_FIRST",
    "LINEAR_FIRST",
    "RKMK",
    "SE3",
    "SO3",
    "XLA",
    "JAX",
    "CommutatorFree",
    "Dynamics",
    "Euclidean",
    "Event",
    "FreeBody",
    "FreeParticle",
    "ZeroOrderHold",
    "ImmutableError",
    "ImplicitRKMK",
    "InputError",
    "IntegrationError",
    "FirstOrderHold",
    "Magnus",
    "Maximize",
    "Minimize",
    "ModelError",
    "Native",
    "Order",
    "OrderError",
    "Product",
    "Result",
    "ShapeError",
    "Solution",
    "Splitting",
    "StepControl",
    "System",
    "TrajectoryError",
    "TwistaxError",
    "charts",
    "compile",
    "compositions",
    "diffrax",
    "integrate",
    "lie",
    "linalg",
    "load",
    "lower",
    "mechanics",
    "pose",
    "spatial",
    "tableaus",
    "tangent_grad",
    "trajectory",
]
__all__ += expr.__all__

#: Loaded when first touched: they bring diffrax or SciPy with them, or serve some models only.
_LAZY_MODULES = ("diffrax", "mechanics", "trajectory")
_LAZY_NAMES = {"Minimize": "trajectory", "Maximize": "trajectory"}


def __getattr__(name: str) -> object:  # `Any` is a node here
    if name in _LAZY_MODULES:
        return importlib.import_module(f"{__name__}.{name}")
    if name in _LAZY_NAMES:
        return getattr(importlib.import_module(f"{__name__}.{_LAZY_NAMES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *_LAZY_MODULES, *_LAZY_NAMES})
