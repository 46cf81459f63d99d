"""Modules that have moved, by their earlier names in files and pickles of earlier versions."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

from ..errors import ModelError

_PACKAGE = __name__.partition(".")[0]
#: Below the package. Only modules whose classes and functions files or pickles may name.
MOVED = {
    "expr.arithmetic": "expr.operations.arithmetic",
    "expr.array": "expr.operations.array",
    "expr.choice": "expr.operations.choice",
    "expr.elementwise": "expr.operations.elementwise",
    "expr.soft": "expr.operations.soft",
    "expr.independent_rows": "expr.matrices.independent_rows",
    "expr.interpolation": "expr.tables.interpolation",
    "expr.linalg": "expr.matrices.linalg",
    "expr.rate": "expr.transformations.rate",
    "expr.solve": "expr.matrices.solve",
    "expr.solve_positive": "expr.matrices.solve_positive",
    "expr.spatial": "expr.lie.spatial",
    "expr.table_kinds": "expr.tables.kinds",
    "expr.vmap": "expr.transformations.vmap",
    "expr.without_numbers": "expr.transformations.without_numbers",
    "integrators.commutator_free": "integrators.methods.commutator_free",
    "integrators.implicit_rkmk": "integrators.methods.implicit_rkmk",
    "integrators.interpolant": "integrators.methods.interpolant",
    "integrators.magnus": "integrators.methods.magnus",
    "integrators.phased_solution": "integrators.phases.phased_solution",
    "integrators.rkmk": "integrators.methods.rkmk",
    "integrators.run": "integrators.loop.outcome",
    "integrators.solution": "integrators.results.solution",
    "lowering.backends": "scalar.backends",
    "lowering.dynamics": "system.dynamics",
    "lowering.explain": "system.explain",
    "lowering.fast": "scalar.fast",
    "lowering.functions": "system.functions",
    "lowering.native.backend": "scalar.targets.llvm.backend",
    "layout": "groups.columns",
    "table_load": "scalar.primitives.table_load",
    "tables": "expr.tables",
    "trajectory.accuracy": "trajectory.strategy.accuracy",
    "trajectory.controls": "trajectory.problem.controls",
    "trajectory.discretize": "linear.discretize",
    "trajectory.external": "trajectory.adapters.solvers",
    "trajectory.functionals": "trajectory.problem.functionals",
    "trajectory.linearize": "linear.linearize",
    "trajectory.mesh": "trajectory.transcription.mesh",
    "trajectory.modes": "linear.modes",
    "trajectory.phase": "trajectory.problem.phase",
    "trajectory.statement": "trajectory.problem.statement",
    "trajectory.strategies": "trajectory.strategy.strategies",
    "trajectory.trimming": "trimming.trim",
    "trajectory.watch": "trajectory.strategy.status",
}
#: Classes that have another name now, or whose module is a package now.
_CLASSES = {
    "expr.operations.elementwise.Function": "expr.operations.elementwise.ElementwiseFunction",
    "integrators.tableaus.Rows": "integrators.tableaus.StageRows",
    "mechanics.loops.Axis": "mechanics.loops.AxisLoop",
    "mechanics.loops.Point": "mechanics.loops.PointLoop",
    "mechanics.loops.Pose": "mechanics.loops.PoseLoop",
    "trajectory.hessians.GaussNewton": "trajectory.hessians.options.GaussNewton",
    "trajectory.hessians.QuasiNewton": "trajectory.hessians.options.QuasiNewton",
    "trajectory.transcription.Collocation": "trajectory.transcription.methods.Collocation",
    "trajectory.transcription.MultipleShooting": "trajectory.transcription.methods.MultipleShooting",
}
#: Modules of problems and of their results, whose parts are others now; and such classes of what is a package now.
_UNREAD = ("trajectory.cases", "trajectory.phased_result", "trajectory.phases", "trajectory.warm")
_UNREAD_CLASSES = ("trajectory.problem.Problem", "trajectory.result.TrajectoryResult")
_EARLIER = {now: earlier for earlier, now in MOVED.items()}
#: Modules all of whose classes come from another one, which has them still for pickles.
_EARLIER |= {"expr.operations.comparisons": "expr.arithmetic", "expr.lie.jacobians": "expr.lie.elements"}
#: Packages that are gone; of their modules those above are left.
_GONE = ("lowering", "lowering.native")


def module_now(module: str) -> str:
    """The present module for an earlier name."""
    package, _, below = module.partition(".")
    return f"{package}.{MOVED[below]}" if package == _PACKAGE and below in MOVED else module


def first_module(cls: type) -> str:
    """The module in which a class was first defined. Files and keys use this name, so that they do not change if the
    class moves.
    """
    package, _, below = cls.__module__.partition(".")
    return f"{package}.{_EARLIER[below]}" if package == _PACKAGE and below in _EARLIER else cls.__module__


class _KeepsNames(ModuleType):
    """A package with a function that has the name of an earlier module, which the import of this must not replace."""

    def __setattr__(self, name: str, value: Any) -> None:
        if not (isinstance(value, ModuleType) and name in vars(self)):
            super().__setattr__(name, value)


class EarlierNames:
    """An import finder that redirects the earlier name of a module to the present module; Python calls it last."""

    @classmethod
    def find_spec(cls, name: str, path: Any = None, target: Any = None) -> ModuleSpec | None:
        package, _, module = name.partition(".")
        if package != _PACKAGE or module not in (*MOVED, *_GONE, *_UNREAD):
            return None
        return ModuleSpec(name, cls, is_package=module in _GONE)  # type: ignore[arg-type]  # a loader by its methods

    @staticmethod
    def create_module(spec: ModuleSpec) -> ModuleType | None:
        return None

    @staticmethod
    def exec_module(module: ModuleType) -> None:
        """A module may replace itself by another one, which the import then enters into its package."""
        package, _, name = module.__name__.rpartition(".")
        if name in vars(sys.modules[package]):
            sys.modules[package].__class__ = _KeepsNames
        if (now := module_now(module.__name__)) != module.__name__:
            sys.modules[module.__name__] = importlib.import_module(now)
        else:
            module.__dict__["__getattr__"] = earlier_classes(module.__name__)


def earlier_classes(module: str) -> Callable[[str], Any]:
    """`__getattr__` of a module for the classes that it had in earlier versions, by their earlier names.

    Raises:
        ModelError: a class that this version does not support.
    """
    _, _, below = module.partition(".")

    def earlier(name: str) -> Any:
        qualified = f"{below}.{name}"
        if (now := _CLASSES.get(qualified)) is not None:
            home, _, class_name = now.rpartition(".")
            return getattr(importlib.import_module(f"{_PACKAGE}.{home}"), class_name)
        if qualified in _UNREAD_CLASSES or (below in _UNREAD and not name.startswith("_")):
            raise ModelError(
                f"this pickle has a {name} of an earlier version of twistax, which this version does not support.\n"
                "  fix: read the pickle with the version that wrote it; or state the problem again, and "
                "solve it with the earlier xs and us as guess"
            )
        raise AttributeError(f"module {module!r} has no attribute {name!r}")

    return earlier


def find_earlier_names() -> None:
    """Enable pickles of earlier versions to find their classes."""
    if EarlierNames not in sys.meta_path:
        sys.meta_path.append(EarlierNames)
