"""Problems of others: both statements say the same, have the same optimum, and the page says who solved what."""

import argparse
import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import twistax as tx
from evaluated import evaluated
from twistax.report import command
from twistax.report.foreign import FOREIGN, page, run
from twistax.report.foreign.ipopt import Nlp, nlp_of
from twistax.report.foreign.page import ForeignReport
from twistax.report.foreign.run import Side
from twistax.report.foreign.statement import MATHS, Foreign, Phased, Points, RungeKutta, Var, coefficients

pytest.importorskip("casadi")

GATE = Foreign(
    name="a mass through a mixed limit",
    source="this test",
    states={"p": Var(start=0.0, end=1.0), "v": Var(-0.1, 0.55, 0.0, 0.0)},
    controls={"u": Var(-4.0, 6.0, guess=0.0)},
    rates=lambda x, m: [x.v, x.u - 0.3 * x.v + 0.2 * m.sin(2.0 * x.t)],
    running=lambda x, m: x.u**2 + x.v**2,
    cost=lambda x, m: 2.0 * x.t,
    path=lambda x, m: {"mixed": (-math.inf, x.u + 2.0 * x.v, 1.3), "place": (-0.1, x.p, 1.1)},
    final_time=(0.5, 4.0, 2.0),
    intervals=12,
    nodes=[(k / 12) ** 1.2 for k in range(13)],
)


def parts_of(problem: Foreign, bag: dict[str, Any], maths: Any) -> list[Any]:
    """Rates, running cost, cost, path rows and end conditions."""
    here = SimpleNamespace(**bag)
    parts: Sequence[Any] = problem.rates(here, maths)
    parts = [*parts, *(part(here, maths) for part in (problem.running, problem.cost) if part)]
    parts += [row for _, row, _ in (problem.path(here, maths) if problem.path else {}).values()]
    return [*parts, *(problem.ends(here, maths, here) if problem.ends else ())]


def difference(problem: Foreign) -> float:
    """Of the formulas in both languages, at a random point, relative to the largest."""
    import casadi as ca

    rng = np.random.default_rng(0)
    unknowns = {**problem.states, **problem.controls, **problem.free}
    values = {name: float(0.3 + 0.5 * rng.uniform()) for name in unknowns} | {"t": 0.37}
    theirs = np.array([float(ca.DM(part)) for part in parts_of(problem, values, ca)])
    leaves: dict[str, Any] = {name: tx.State(name) for name in unknowns}
    exprs = [tx.to_expr(part) for part in parts_of(problem, leaves | {"t": tx.Time()}, MATHS)]
    mine = np.array(evaluated(exprs, values))
    assert np.isfinite(theirs).all()
    return float(np.max(np.abs(mine - theirs)) / (1.0 + np.max(np.abs(theirs))))


def phases(problem: Foreign | Phased) -> Sequence[Foreign]:
    return problem.phases if isinstance(problem, Phased) else [problem]


def test_there_are_forty_with_a_source_each() -> None:
    assert len(FOREIGN) >= 40
    assert len({problem.name for problem in FOREIGN.values()}) == len(FOREIGN)
    assert all(problem.source for problem in FOREIGN.values())


def test_formulas_agree_in_both_languages() -> None:
    assert difference(GATE) < 1e-14


@pytest.mark.parametrize("name", FOREIGN)
def test_both_statements_build_and_agree(name: str) -> None:
    """Of every problem: IPOPT's has a finite start, ours is accepted, and their formulas are the same."""
    build(FOREIGN[name])


def build(problem: Foreign | Phased) -> None:
    nlp = nlp_of(problem)
    at = nlp.opti.debug.value
    assert math.isfinite(float(at(nlp.cost, nlp.opti.initial())))
    assert np.isfinite(np.asarray(at(nlp.opti.g, nlp.opti.initial()), float)).all()
    assert [part.nodes for part in problem.twistax().parts] == [phase.intervals + 1 for phase in phases(problem)]
    assert max(map(difference, phases(problem))) < 1e-12


def test_one_builds_and_is_solved_by_ipopt() -> None:
    problem = FOREIGN["rocket"]
    build(problem)
    side = run.ipopt(problem, 30.0)
    assert side.solved, side.word
    assert math.isclose(side.cost, 5.60326362, rel_tol=1e-8)


@pytest.mark.parametrize(("kind", "points"), [("legendre", 1), ("legendre", 3), ("radau", 1), ("radau", 2)])
def test_collocation_is_that_of_casadi(kind: str, points: int) -> None:
    import casadi as ca

    a, b, c = coefficients(kind, points)
    assert np.allclose(c, ca.collocation_points(points, kind), rtol=0.0, atol=1e-14)
    for power in range(points):
        assert np.allclose(a @ c**power, c ** (power + 1) / (power + 1), rtol=0.0, atol=1e-14)
        assert math.isclose(b @ c**power, 1.0 / (power + 1), rel_tol=1e-13)


@pytest.mark.parametrize("linear", [False, True])
@pytest.mark.parametrize("rule", [RungeKutta(1), RungeKutta(2), Points(2)])
def test_both_have_one_optimum(rule: Any, linear: bool) -> None:
    """The transcriptions are the same: binding limits of states between substeps, of controls, mixed ones, a free
    final time, unequal intervals, a running cost and time in the rates."""
    problem = dataclasses.replace(GATE, rule=rule, linear=linear)
    nlp = nlp_of(problem)
    nlp.prepare(60.0)
    solved, cost, _, word = nlp.solve()
    assert solved, word
    result = problem.twistax().solve(tolerance=1e-9, mesh_tolerance=np.inf)
    assert result.solved, result.message
    assert math.isclose(result.cost, cost, rel_tol=1e-7)


# ---- the page --------------------------------------------------------------------------------------------------------


def options(**values: Any) -> argparse.Namespace:
    return argparse.Namespace(only=None, quick=True, **values)


def made_up(monkeypatch: pytest.MonkeyPatch, mine: Side) -> list[str]:
    """What the report of one problem finds wrong where IPOPT has an optimum of 2 in 10 steps, 1 s and 0.1 s."""
    monkeypatch.setattr(page, "ipopt", lambda problem, seconds: Side(True, "Solve_Succeeded", 2.0, 10, 1.0, 0.1))
    monkeypatch.setattr(page, "ours", lambda problem, seconds: mine)
    report = ForeignReport({"gate": GATE}, options())
    kept: dict[Any, Any] = {}
    report.store = SimpleNamespace(  # type: ignore[assignment]
        get=lambda *key: kept.get(key), add=lambda rows: kept.update({row.key: row for row in rows})
    )
    for part in report.parts:
        report.measure(part, lambda what, share: None)
    text = " ".join(map(str, report.context()["table"][1][0]))
    return [*report.problems(), text]


def test_the_same_optimum_holds_and_ratios_are_ours_over_theirs(monkeypatch: pytest.MonkeyPatch) -> None:
    *wrong, line = made_up(monkeypatch, Side(True, "SOLVED", 2.0 + 1e-6, 9, 2.0, 0.007))
    assert wrong == []
    assert "SOLVED SOLVED" in line
    assert "same 10 9 0.9 1 2 2 100 7 0.07" in line


@pytest.mark.parametrize(
    ("mine", "said", "wrong"),
    [
        (Side(True, "SOLVED", 1.9, 9, 2.0, 0.007), "better by 5.0e-02", 0),
        (Side(True, "SOLVED", 2.1, 9, 2.0, 0.007), "worse by 5.0e-02", 1),
        (Side(False, "STALLED", 2.0, 9, 2.0), "SOLVED STALLED", 1),
        (Side(False, "no answer in 15 s"), "no answer in 15 s", 1),
    ],
)
def test_worse_and_unsolved_are_told(monkeypatch: pytest.MonkeyPatch, mine: Side, said: str, wrong: int) -> None:
    *lines, line = made_up(monkeypatch, mine)
    assert said in line
    assert sum(each.startswith(GATE.name) for each in lines) == wrong


def test_a_larger_maximum_is_better() -> None:
    mine, theirs = Side(True, "SOLVED", 3.0), Side(True, "", 2.0)
    assert run.excess_cost(dataclasses.replace(GATE, maximise=True), mine, theirs) == -0.5
    assert run.excess_cost(GATE, mine, theirs) == 0.5


def test_a_side_that_hangs_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    def forever(self: Foreign) -> None:
        while True:
            pass

    monkeypatch.setattr(Foreign, "twistax", forever)
    assert run.ours(GATE, 0.05).word == "no answer in 0.05 s of the processor"


def test_a_failure_of_ipopt_has_its_word() -> None:
    import casadi as ca

    opti = ca.Opti()
    x = opti.variable()
    opti.subject_to(x**2 == -1.0)
    nlp = Nlp(opti, x)
    nlp.prepare(10.0)
    solved, *_, word = nlp.solve()
    assert not solved
    assert "Infeasible" in word or "Restoration" in word


def test_the_command_wants_casadi_and_optimal(monkeypatch: pytest.MonkeyPatch, capsys: Any, tmp_path: Path) -> None:
    arguments = argparse.Namespace(
        **dict.fromkeys(("only", "scene", "method", "case", "renew", "quick")), foreign=True, optimal=False
    )
    assert command.run(arguments) == 2
    assert "--foreign goes with --optimal" in capsys.readouterr().err
    there = command.importlib.util.find_spec
    monkeypatch.setattr(command.importlib.util, "find_spec", lambda name: None if name == "casadi" else there(name))
    arguments.optimal = True
    assert command.run(arguments) == 2
    assert "pip install 'twistax[casadi]'" in capsys.readouterr().err
