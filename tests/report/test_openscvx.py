"""The section beside OpenSCvx: where that is not installed, and with what it says made up by hand."""

import ast
import dataclasses
import importlib.util
import subprocess
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from twistax.report.harness import expected
from twistax.report.harness.page import table_of
from twistax.report.registry import OPTIMAL
from twistax.report.sections import openscvx
from twistax.trajectory.result.result import Trajectory

FASTEST = next(name for name in openscvx.PROBLEMS if name.startswith("least time"))
TURN = next(name for name in openscvx.PROBLEMS if name.startswith("half turn"))


def test_without_openscvx_a_row_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(expected.importlib.util, "find_spec", lambda name: None)
    asked = [check for check in OPTIMAL["openscvx"] if ", twistax" not in check.what]
    assert len(asked) == 15 * len(openscvx.PROBLEMS)
    for check in asked:
        row = check.run()
        assert row.note == "not run: openscvx is not installed; pip install 'twistax[openscvx]'"
        assert row.holds is None


def test_every_problem_is_stated_in_its_program() -> None:
    tree = ast.parse(Path(openscvx.__file__).parents[1].joinpath("openscvx_problems.py").read_text())
    defined = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
    assert {it.name for it in openscvx.PROBLEMS.values()} <= defined


def _path(miss: float, beyond: float) -> Any:
    path = object.__new__(Trajectory)
    vars(path).update(dense=SimpleNamespace(misses={"p": {"distance": miss}}, violations={"speed": beyond}))
    return path


def test_a_line_for_each_of_three() -> None:
    """Of values made up: relative to the optimum, by each, whether or not it says that it is solved."""
    ours = openscvx.PeerSolve(2.0, True, _path(1e-9, 0.0), 12, 1.5, 0.01)
    theirs = {
        False: openscvx.PeerSolve(2.5, True, _path(0.1, 0.02), 143, 4.0, 1.25),
        True: openscvx.PeerSolve(1.5, False, _path(1e-3, 0.0), 200, 5.0, 2.0),
    }

    class MadeUp(openscvx.PeerProblem):
        def ours(self) -> openscvx.PeerSolve:
            return ours

        def theirs(self, same_transcription: bool) -> openscvx.PeerSolve:
            return theirs[same_transcription]

        def difference(self) -> float:
            return 0.0

    fields = vars(openscvx.PROBLEMS[FASTEST])
    it = MadeUp(**{field.name: fields[field.name] for field in dataclasses.fields(openscvx.PeerProblem)})
    rows = [check.run("openscvx") for check in openscvx._rows("mass", it)]
    head, table, _ = table_of(rows, wide=True)
    found = {cells[0]: dict(zip(head, cells, strict=True)) for cells in table}
    assert list(found) == [
        "mass, both",
        "mass, twistax",
        "mass, OpenSCvx as it comes",
        "mass, OpenSCvx, held controls and weights of its own",
    ]
    assert found["mass, both"]["statements differ by (at most 1e-10)"] == "0"
    _, mine, default, alike = found.values()
    columns = ("apart", "says that it is solved", "a rollout misses the end by", "beyond limits between nodes", "steps")
    assert [mine[by] for by in columns] == ["0", "1", "1e-9", "0", "12"]
    assert [default[by] for by in columns] == ["0.25", "1", "0.1", "0.02", "143"]
    assert [alike[by] for by in columns] == ["0.25", "0", "0.001", "0", "200"]
    assert (default["compile, s"], default["solve, ms"]) == ("4", "1,250")


def test_what_its_program_ended_with_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    ended = SimpleNamespace(returncode=1, stdout="", stderr="Traceback\n  ...\nValueError: no such state\n")
    monkeypatch.setattr(openscvx, "needed", lambda *_: None)
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: ended)
    it = dataclasses.replace(openscvx.PROBLEMS[FASTEST])
    for measure in (it.difference, lambda: it.theirs(True)):
        with pytest.raises(RuntimeError, match=r"^ValueError: no such state$"):
            measure()


@pytest.fixture
def answered(monkeypatch: pytest.MonkeyPatch) -> Callable[..., openscvx.PeerProblem]:
    """A problem whose answer is given."""
    monkeypatch.setattr(openscvx, "needed", lambda *_: None)

    def make(name: str, **said: Any) -> openscvx.PeerProblem:
        it = dataclasses.replace(openscvx.PROBLEMS[name])
        vars(it)["_answers"] = [said, said]
        return it

    return make


def _column(values: Any) -> list[list[float]]:
    return np.reshape(values, (len(values), -1)).tolist()


def _bang(final: float = 2.0) -> dict[str, Any]:
    """The optimum of the least time: full thrust, then full brakes, at 21 nodes."""
    ts = np.linspace(0.0, final, 21)
    u = np.where(np.arange(21) < 10, 1.0, -1.0)
    p, v = np.where(ts <= 1.0, 0.5 * ts**2, 1.0 - 0.5 * (2.0 - ts) ** 2), np.where(ts <= 1.0, ts, 2.0 - ts)
    nodes = {name: _column(values) for name, values in {"time": ts, "p": p, "v": v, "u": u}.items()}
    return {"value": final, "converged": True, "iterations": 14, "initialize": 5.0, "solve": 0.2, "nodes": nodes}


def test_its_controls_are_rolled_out(answered: Callable[..., openscvx.PeerProblem]) -> None:
    found = answered(FASTEST, **_bang()).theirs(True)
    assert (found.value, found.iterations) == (2.0, 14)
    assert openscvx._missed(found) < 1e-12
    assert max(found.trajectory.between_nodes.values()) < 1e-12
    # Linear between nodes they go through zero in the interval before the brakes: 0.05 s of thrust less.
    linear = answered(FASTEST, **_bang()).theirs(False)
    assert openscvx._missed(linear) == pytest.approx(0.1, abs=0.02)
    said = _bang()
    said["nodes"]["u"][3] = [1.5]
    beyond = answered(FASTEST, **said).theirs(True)
    assert max(beyond.trajectory.between_nodes.values()) == pytest.approx(0.5)
    assert openscvx._missed(beyond) > 0.05


def _stated(**changes: Any) -> dict[str, Any]:
    """What is stated of the least time, with changes."""
    p, v, u = np.random.default_rng(1).normal(size=(3, 4))
    said = {
        "points": {"p": _column(p), "v": _column(v), "u": _column(u)},
        "rates": {"p": _column(v), "v": _column(u)},
        "constraints": [],
        "ends": {"p": [[0.0], [1.0]], "v": [[0.0], [0.0]]},
        "limits": {"p": [[-1.0], [2.0]], "v": [[-2.0], [2.0]], "u": [[-1.0], [1.0]]},
        "time": [3.25, 6.0],
    }
    return {"stated": said | changes}


@pytest.mark.parametrize(
    "changes",
    [
        {"rates": {"p": [[1.0]] * 4, "v": [[1.0]] * 4}},
        {"ends": {"p": [[0.0], [1.0]], "v": [[0.0], [0.1]]}},
        {"ends": {"p": [[0.0], [1.0]], "v": [[0.0], [None]]}},
        {"limits": {"p": [[-1.0], [2.0]], "v": [[-2.0], [2.0]], "u": [[-1.0], [1.1]]}},
        {"time": [3.25, 7.0]},
    ],
    ids=["rates", "end", "free end", "limits", "time"],
)
def test_another_statement_is_seen(answered: Callable[..., openscvx.PeerProblem], changes: dict[str, Any]) -> None:
    assert answered(FASTEST, **_stated()).difference() == 0.0
    assert not answered(FASTEST, **_stated(**changes)).difference() < 0.05


def test_quaternions_are_read_as_rotations(answered: Callable[..., openscvx.PeerProblem]) -> None:
    rng = np.random.default_rng(2)
    q, w, u = rng.normal(size=(5, 4)), rng.normal(size=(5, 3)), rng.normal(size=(5, 3))
    q /= np.linalg.norm(q, axis=1)[:, None]
    turned = [np.concatenate([[-a[1:] @ b], a[0] * b + np.cross(a[1:], b)]) / 2.0 for a, b in zip(q, w, strict=True)]
    # The sign of a quaternion means nothing.
    half, rest = [[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, -1.0]], [[0.0] * 3] * 2
    said = {
        "points": {"q": q.tolist(), "w": w.tolist(), "u": u.tolist()},
        "rates": {"q": np.array(turned).tolist(), "w": u.tolist()},
        "constraints": [],
        "ends": {"q": half, "w": rest},
        "limits": {"u": [[-1.0] * 3, [1.0] * 3]},
        "time": [3.5, 6.0],
    }
    assert answered(TURN, stated=said).difference() < 1e-14
    said["ends"]["q"] = [half[0], [0.0, 0.0, 1.0, 0.0]]
    assert answered(TURN, stated=said).difference() > 1.0


@pytest.mark.skipif(importlib.util.find_spec("openscvx") is None, reason="OpenSCvx is not installed")
def test_its_program_runs() -> None:
    it = openscvx.PROBLEMS[FASTEST]
    assert it.difference() <= 1e-10
    found = it.theirs(True)
    assert found.says_solved
    assert found.value == pytest.approx(2.0, rel=1e-6)
