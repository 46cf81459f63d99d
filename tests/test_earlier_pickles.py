"""Pickles of earlier versions: classes are found where they are now, or the error says what to do."""

import copy
import importlib
import inspect
import pickle
from typing import Any

import pytest

import twistax as tx
from twistax import trajectory
from twistax.errors import ModelError

#: Where earlier versions had them.
EARLIER: dict[str, Any] = {
    "integrators.rkmk RKMK": tx.RKMK,
    "integrators.solution Solution": tx.Solution,
    "lowering.dynamics Dynamics": tx.Dynamics,
    "lowering.fast fast": tx.fast,
    "trajectory.accuracy Accuracy": trajectory.Accuracy,
    "trajectory.discretize Discretization": trajectory.Discretization,
    "trajectory.external IPOPT": trajectory.IPOPT,
    "trajectory.hessians GaussNewton": trajectory.GaussNewton,
    "trajectory.hessians QuasiNewton": trajectory.QuasiNewton,
    "trajectory.linearize Linearization": trajectory.Linearization,
    "trajectory.mesh Mesh": trajectory.Mesh,
    "trajectory.modes Mode": tx.Mode,
    "trajectory.phase Phase": trajectory.Phase,
    "trajectory.strategies Strategy": trajectory.Strategy,
    "trajectory.transcription Collocation": trajectory.Collocation,
    "trajectory.transcription MultipleShooting": trajectory.MultipleShooting,
    "trajectory.trimming Trim": tx.Trim,
    "trajectory.watch Status": trajectory.Status,
}
UNREAD = [
    "trajectory.cases TrajectoryResults",
    "trajectory.phased_result PhasedResult",
    "trajectory.phases PhasedProblem",
    "trajectory.problem Problem",
    "trajectory.result TrajectoryResult",
    "trajectory.warm WarmStart",
]


def pickled(earlier: str) -> bytes:
    """The pickle of a class by its module and its name."""
    module, name = earlier.split()
    return f"ctwistax.{module}\n{name}\n.".encode()


@pytest.mark.parametrize("earlier", EARLIER)
def test_classes_are_where_they_are_now(earlier: str) -> None:
    assert pickle.loads(pickled(earlier)) is EARLIER[earlier]


def test_stages_of_a_tableau_have_another_name() -> None:
    rows = pickle.loads(pickled("integrators.tableaus Rows"))
    assert pickle.loads(pickle.dumps(rows(1.0, 2.0))) == (1.0, 2.0)


@pytest.mark.parametrize("earlier", UNREAD)
def test_what_this_version_does_not_read_says_so(earlier: str) -> None:
    with pytest.raises(ModelError, match=f"has a {earlier.split()[1]} of an earlier version(.|\n)*state the problem"):
        pickle.loads(pickled(earlier))


def test_other_names_are_missing_as_ever() -> None:
    with pytest.raises(AttributeError, match=r"trajectory\.hessians"):
        pickle.loads(pickled("trajectory.hessians Newton"))
    with pytest.raises(ModuleNotFoundError):
        pickle.loads(pickled("trajectory.nowhere Newton"))


@pytest.mark.parametrize("member", [*trajectory.Status, *trajectory.Strategy])
def test_a_status_is_pickled_by_name(member: Any) -> None:
    """Its sentence may be another one in a later version."""
    data = pickle.dumps(member)
    assert member.value.encode() not in data
    assert pickle.loads(data) is copy.deepcopy(member) is member


@pytest.mark.parametrize("name", ["discretize", "linearize"])
def test_functions_with_the_name_of_an_earlier_module_stay(name: str) -> None:
    """The import of a module names it in its package."""
    importlib.import_module(f"twistax.trajectory.{name}")
    assert inspect.isfunction(getattr(trajectory, name))
