"""Every public name says in its docstring what it takes and raises, its maths, shapes, units and source, or there is a
reason why it does not, here or in `reference_reasons.toml`.

That they are right no test can tell from text; `tests/expr/test_conformance.py` runs every node, and compares shapes
and errors with its docstring.
"""

import enum
import fnmatch
import inspect
import re
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

from test_docs import execution, module_of_site
from twistax.expr import Expr, elementwise

NAMES = [name for name in module_of_site("names").public_names() if getattr(name.value, "__module__", "") != "typing"]


def is_value(value: Any) -> bool:
    """A number, a tableau, an alias of types: it has no docstring of its own, and prints what it is."""
    return not inspect.isclass(value) and not inspect.isroutine(value) and not hasattr(value, "__wrapped__")


DOCUMENTED = [
    name
    for name in NAMES
    if not is_value(name.value) and not (inspect.isclass(name.value) and issubclass(name.value, BaseException))
]
by_name = pytest.mark.parametrize("name", DOCUMENTED, ids=lambda name: name.path.removeprefix("twistax."))

#: Why some say nothing of errors.
NO_ERRORS = {
    "users get these and do not make them": """
        AtStart Between Crossings Dynamics Mode Order PhasedSolution Result columns.Column Simulator
        estimation.Consistency estimation.Estimate estimation.FilterRun estimation.Innovations estimation.Observability
        estimation.Prediction estimation.Smoothed estimation.Update estimation.Verdict estimation.AllanVariance
        estimation.GroupAffinity estimation.InertialState estimation.Invariance estimation.PreintegratedImu
        estimation.BatchEstimate estimation.Combination estimation.ParameterEstimate Solution Statistics
        Sweep Trim charts.Coordinates diffrax.AmbientTerm diffrax.LieController diffrax.LieTerm mechanics.DaveModel
        mechanics.BaseParameters mechanics.Bristles mechanics.GivenForces mechanics.ReachResult mechanics.ReachStatus
        mechanics.WitnessPoints
        mechanics.Regressor mechanics.Identification mechanics.IdentificationStatus mechanics.DifferentialStep
        mechanics.OperationalSpace mechanics.StepStatus
        mechanics.joints.Screws mechanics.environment.earth.Geodetic mechanics.flight.AirData
        mechanics.flight.Gust mechanics.flight.ImuReading trajectory.Discretization trajectory.Linearization
        trajectory.Accuracy trajectory.ControllerLog
        trajectory.Meshed trajectory.Optimality trajectory.PhasedResult trajectory.PhasedResults
        trajectory.Solution trajectory.Status trajectory.StepRecord trajectory.Strategy trajectory.TrajectoryResult
        trajectory.TrajectoryResults
        trajectory.WarmStart view.Body view.Scene""",
    "it takes no arguments": """
        JAX Time mechanics.chain_models.panda trajectory.Held charts.Ambient tables.BSpline tables.Clamped
        tables.Extrapolated tables.Linear tables.MonotoneCubic tables.Refused""",
    "a base, whose subclasses say it": "Expr Leaf Variable Constraint Example charts.Chart columns.Layout",
    "the base class says it": "view.Box view.Capsule view.Cone view.Cylinder view.Ellipsoid view.Sphere",
    "it takes every shape": """
        Neg linalg.Sum linalg.Transpose mechanics.environment.atmosphere.Pressure
        mechanics.environment.atmosphere.Temperature""",
    "what it is part of checks it": """
        columns.Rotations
        Maximize Minimize Control trajectory.Phase
        charts.SplitExponential""",
    "it is called by a vehicle, which has checked": """
        mechanics.flight.body_axes mechanics.flight.fixed_axes mechanics.flight.inertial_axes
        mechanics.flight.local_axes mechanics.flight.stability_axes mechanics.flight.wind_axes""",
    "a protocol: what others have to offer": "mechanics.flight.Air mechanics.flight.Gravity",
}

#: Arguments that need no word where they stand: what the functions of a package share, and what the first line says.
KNOWN = {
    "mechanics": "mechanism q qd qdd tau wrenches axes frame planet air latitude altitude ned_velocity",
    "lie": "R T X W xi omega momentum points",
    "trajectory": "dynamics t params problem",
    "diffrax": "dynamics ambient",
    "trim": "dynamics",
}

#: Why some do not name what they are made with.
NO_ARGUMENTS = {
    "users get these and do not make them": """
        Order Simulator Sweep diffrax.LieTerm mechanics.DaveModel trajectory.PhasedResult trajectory.PhasedResults
        trajectory.ControllerLog trajectory.Solution trajectory.TrajectoryResult
        trajectory.TrajectoryResults Example""",
    "the base class says it": """
        Maximize Minimize charts.SplitExponential view.Box view.Capsule view.Cone view.Cylinder view.Ellipsoid
        view.Sphere""",
    "one argument, which the first line is about": "Product units.Quantity",
}


#: How a docstring shows that it says it.
SAYS = {
    "maths": r"\$[^$]+\$|[\w)\]'}] (=|<=|>=) [\w(\[-]|\^|\w [*/] \w|->|\bExp\(|\bLog\(|\w x \w\b",
    "shapes": r"[Ss]hape|->|\((\d|n|m|k|s|\w+,)[^)]*\)|\(\)|\bscalars?\b|\bnumbers?\b|\barrays?\b",
    "units": r"\b(m|s|rad|kg|N|Pa|K|deg|Hz|J|W|m2|units?|seconds|dimensionless|degrees)\b",
    "source": r"Source|\b(19|20)\d\d\b",
}
#: By what it does not say: why, and the names or patterns of names of which it is true.
REASONS = {
    asked: [(why, word) for why, words in table.items() for word in words.split()]
    for asked, table in tomllib.loads((Path(__file__).parent / "reference_reasons.toml").read_text()).items()
}


def silent(asked: str) -> list[Any]:
    """The names whose docstrings do not say it."""
    return [name for name in DOCUMENTED if not re.search(SAYS[asked], inspect.getdoc(name.value) or "")]


def fits(word: str, name: Any) -> bool:
    return name.is_node if word == "nodes" else fnmatch.fnmatchcase(name.path.removeprefix("twistax."), word)


@pytest.mark.parametrize("asked", SAYS)
def test_it_says_its_maths_shapes_units_and_source_or_why_not(asked: str) -> None:
    words = [word for _, word in REASONS[asked]]
    assert [name.path for name in silent(asked) if not any(fits(word, name) for word in words)] == []


@pytest.mark.parametrize("asked", SAYS)
def test_every_reason_is_needed(asked: str) -> None:
    names = silent(asked)
    assert [word for _, word in REASONS[asked] if not any(fits(word, name) for name in names)] == []


def excused(table: dict[str, str], name: Any) -> bool:
    words = {word for line in table.values() for word in line.split()}
    return name.path.removeprefix("twistax.") in words


@by_name
def test_it_has_a_first_sentence(name: Any) -> None:
    text = inspect.getdoc(name.value) or ""
    assert re.search(r"[.:]$", text.split("\n\n")[0].strip())


@by_name
def test_it_says_what_it_raises(name: Any) -> None:
    entrywise = name.is_node and issubclass(name.value, elementwise.Entrywise)  # these take every shape
    says = bool(re.search(r"[Rr]aise|Error", inspect.getdoc(name.value) or ""))
    assert says or entrywise or excused(NO_ERRORS, name)
    assert not (says and excused(NO_ERRORS, name)), "the excuse is not needed any more"


@by_name
def test_it_names_what_it_takes(name: Any) -> None:
    """Fields of nodes are the matter of the conformance suite."""
    enumeration = inspect.isclass(name.value) and issubclass(name.value, enum.Enum)
    if name.is_node or enumeration or excused(NO_ARGUMENTS, name):
        return
    text = inspect.getdoc(name.value) or ""
    known = KNOWN.get(name.path.split(".")[1], "").split()
    taken = [
        p.name
        for p in inspect.signature(name.value).parameters.values()
        if p.kind not in (p.VAR_POSITIONAL, p.VAR_KEYWORD) and not p.name.startswith("_")
    ]
    assert [word for word in taken if word not in known and not re.search(rf"\b{word}\b", text)] == []


@pytest.mark.parametrize("table", [NO_ERRORS, NO_ARGUMENTS], ids=["errors", "arguments"])
def test_excuses_are_of_names_that_are_there(table: dict[str, str]) -> None:
    there = {name.path.removeprefix("twistax.") for name in DOCUMENTED}
    words = [word for line in table.values() for word in line.split()]
    assert len(set(words)) == len(words)
    assert set(words) - there == set()


def test_all_kinds_are_found() -> None:
    paths = {name.path for name in DOCUMENTED}
    assert {"twistax.compile", "twistax.lie.se3.exp", "twistax.trajectory.Problem", "twistax.Abs"} <= paths
    assert sum(issubclass(name.value, Expr) for name in DOCUMENTED if inspect.isclass(name.value)) > 60


def test_its_signature_has_types() -> None:
    """Of every argument; enumerations and protocols are not called."""
    signatures = module_of_site("signatures")
    found = {name.path: signatures.signature(name.value) for name in DOCUMENTED}
    assert {path: of.untyped for path, of in found.items() if of and of.untyped} == {}
    assert sum(of is None for of in found.values()) < 13
    assert found["twistax.lie.Adjoint"].arguments == (
        "(twist1: ExprLike, twist2: ExprLike, order: Order = LINEAR_FIRST)"
    )
    assert found["twistax.lie.se3.exp"].returns == "Float[Array, '4 4']"


def test_it_has_an_example(monkeypatch: pytest.MonkeyPatch) -> None:
    """A block of docs/reference/examples, a statement of a page or of the gallery, or a case of a node."""
    monkeypatch.setitem(sys.modules, "execution", execution)
    monkeypatch.setitem(sys.modules, "names", module_of_site("names"))
    snippets = module_of_site("snippets")
    there = snippets.snippets()
    assert [name.path for name in DOCUMENTED if name.path not in there] == []
    assert set(snippets.written()) - {name.path for name in NAMES} == set(), "of no public name"
    assert "R = tx.lie.so3.exp(w)" in there["twistax.lie.so3.log"].code
    assert there["twistax.lie.so3.log"].printed.startswith("Array([0.")
