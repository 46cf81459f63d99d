"""`python -m twistax report --speed`: what agrees is timed, what is missing is named."""

import argparse
import csv
import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import twistax as tx
from twistax.report.command import run_report
from twistax.report.harness.rows import ReportRow
from twistax.report.harness.store import Origin, Store
from twistax.report.harness.timing import Repeats, Timed
from twistax.report.speed import page
from twistax.report.speed.cases import CASES, FREE_BODY, EvaluatedFunction
from twistax.report.speed.contenders import (
    JACOBIAN,
    LOOP,
    PLAIN,
    SCALARS,
    SINGLE,
    VALUE,
    Contender,
    DerivativeKind,
    Lacks,
    Task,
    batch,
    relative_difference,
    values,
)
from twistax.report.speed.page import QUICK, measure
from twistax.report.speed.peers import CASADI, CASADI_LANES, in_c, in_lanes

ORIGIN = Origin({"jax": "1"}, "abc", "a machine", {})
SHORT = dataclasses.replace(QUICK, cases=("free-body",), largest=64, repeats=Repeats(2, 1, 1e-3))


class Pretending:
    """Results that are ones, off by a factor; some uses may be refused."""

    def __init__(self, shape: tuple[int, ...], factor: float, seconds: float, refuses: str) -> None:
        self._shape, self._factor, self._seconds, self._refuses = shape, factor, seconds, refuses

    def _program(self, evaluations: int, *points: int) -> Timed:
        return Timed(lambda: np.full((*points, *self._shape), self._factor), evaluations, self._seconds)

    def single(self) -> Timed:
        return self._program(1)

    def loop(self, steps: int) -> Timed:
        if self._refuses == "loop":
            raise Lacks("it has no loop")
        return self._program(steps)

    def batch(self, count: int) -> Timed:
        return self._program(count, count)


def pretender(name: str, factor: float = 1.0, seconds: float = 0.1, refuses: str = "", needs: str = "") -> Contender:
    def task(case: EvaluatedFunction, quantity: DerivativeKind) -> Task:
        return Pretending(quantity.shape(case), factor, seconds, refuses)

    return Contender(name, "C0", task, tool=needs)


def run(folder: Path, *contenders: Contender) -> int:
    given = argparse.Namespace(
        out=folder,
        quick=True,
        again=False,
        renew=None,
        no_progress=True,
        only=None,
        stability=False,
        speed=True,
        figures=False,
        scene=None,
        method=None,
        case=None,
    )
    return run_report(page.Speed(given, contenders), given)


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page, "QUICK", SHORT)


def test_a_run_says_who_is_absent_and_who_disagrees(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    gone = pretender("gone", needs="no-such-tool")
    assert run(tmp_path, pretender("ours"), pretender("plain JAX", 1 + 1e-12), pretender("wrong", 1 + 1e-6), gone) == 1
    said = capsys.readouterr().out
    assert "absent    gone: there is no no-such-tool" in said
    assert "doubt     wrong disagrees by 1e-06: free-body value in a loop" in said

    with (tmp_path / "speed.csv").open() as file:
        table = list(csv.DictReader(file))
    assert {row["by"] for row in table} == {"ours", "plain JAX", "wrong"}
    assert len(table) == 3 * 3  # a call, a loop, a batch of 64
    for row in table:
        timed = row["by"] != "wrong"
        assert (row["note"] == "done") == timed
        assert (row["value"] != "") == timed
        if timed:
            assert 0.0 < float(row["fastest"]) <= float(row["lower"]) <= float(row["value"]) <= float(row["upper"])
    document = json.loads((tmp_path / "speed.json").read_text())
    assert len(document["rows"]) == 9
    for name in ("speed.md", "speed.html"):
        text = (tmp_path / name).read_text()
        assert "gone is absent" in text
        assert "Not all results agree" in text
        assert document["machine"] in text
        assert "no XLA flag" in text
    assert (tmp_path / "figures/speed-value.svg").stat().st_size < 100_000


def test_what_was_measured_is_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    both = pretender("ours"), pretender("plain JAX")
    assert run(tmp_path, *both) == 0
    assert "   6 rows" in capsys.readouterr().out
    document = json.loads((tmp_path / "speed.json").read_text())
    del document["rows"][-2:]
    (tmp_path / "speed.json").write_text(json.dumps(document))
    assert run(tmp_path, *both) == 0
    assert "   2 rows" in capsys.readouterr().out  # the last use, in which two rows were missing
    assert run(tmp_path, *both) == 0
    assert "   0 rows" in capsys.readouterr().out


def test_bars_are_ratios_and_seconds_to_compile() -> None:
    def row(by: str, value: float, use: str = "in a loop") -> ReportRow:
        return ReportRow("aba-7", "value", by, use, value, numbers={"compile_seconds": 2.0})

    found = {
        (each.by, each.setting): each
        for each in page.bar_rows([row("twistax XLA", 1.0), row("plain JAX", 4.0)], "aba-7")
    }
    assert (found["twistax XLA", "over plain JAX"].value, found["twistax XLA", "over plain JAX"].verdict) == (
        0.25,
        "MISSED",
    )
    assert found["twistax XLA", "compiling"].came == "2 s"
    assert found["twistax XLA", "compiling"].holds is False
    assert found["twistax native", "over CasADi C"].verdict == "not run"


def measured(
    store: Store, contenders: Sequence[Contender], case: EvaluatedFunction = CASES["free-body"]
) -> dict[Any, ReportRow]:
    measure(case, VALUE, [SINGLE, LOOP, batch(8)], contenders, SHORT, store)
    return {(row.by, row.setting): row for row in store}


def test_what_would_take_too_long_is_left_out(tmp_path: Path) -> None:
    """It goes by the batch before; calls from Python and loops say nothing of a batch."""
    store, hurried = Store(tmp_path / "rows.json", ORIGIN), dataclasses.replace(SHORT, longest=1e-12)
    uses = [SINGLE, batch(64), batch(4096)]
    measure(CASES["free-body"], VALUE, uses, [pretender("ours")], hurried, store)
    results = {row.setting: row.note for row in store}
    assert [results[use.name] for use in uses] == ["done", "done", "a call would take 0 s"]


def test_a_use_that_is_refused_says_why(tmp_path: Path) -> None:
    store = Store(tmp_path / "rows.json", ORIGIN)
    rows = measured(store, [pretender("ours"), pretender("peer", refuses="loop")])
    assert rows["peer", "in a loop"].note == "it has no loop"
    assert rows["peer", "batch of 8"].done
    again = Store(tmp_path / "rows.json", ORIGIN)
    assert len(again) == 6
    assert again.get("free-body", "value", "ours", "single call") == rows["ours", "single call"]


def test_what_compiles_for_too_long_is_not_compiled_again(tmp_path: Path) -> None:
    store = Store(tmp_path / "rows.json", ORIGIN)
    rows = measured(store, [pretender("ours"), pretender("slow", seconds=SHORT.patience + 1.0)])
    assert rows["slow", "single call"].done
    assert rows["slow", "in a loop"].note == f"compiling another use took {SHORT.patience + 1.0:.0f} s"


def test_a_failure_of_a_peer_ends_its_row_alone(tmp_path: Path) -> None:
    def task(case: EvaluatedFunction, quantity: DerivativeKind) -> Task:
        raise RuntimeError("RESOURCE_EXHAUSTED: Out of memory\nand more")

    rows = measured(Store(tmp_path / "rows.json", ORIGIN), [pretender("ours"), Contender("peer", "C1", task)])
    assert rows["peer", "in a loop"].note == "failed: RESOURCE_EXHAUSTED: Out of memory"
    assert rows["ours", "in a loop"].done


def test_the_difference_is_relative_to_the_largest_entry_of_a_point() -> None:
    reference = np.array([[1.0, 2.0], [100.0, 0.0]])
    assert relative_difference(reference, reference, 1) == 0.0
    assert relative_difference(reference + np.array([[0.0, 0.0], [0.0, 1.0]]), reference, 1) == pytest.approx(1e-2)
    assert relative_difference(reference + np.array([[1.0, 0.0], [0.0, 0.0]]), reference, 1) == pytest.approx(0.5)
    assert relative_difference(reference[:, :1], reference, 1) == np.inf
    assert relative_difference(np.full((2, 2), np.nan), reference, 1) == np.inf


def test_ours_and_plain_jax_agree_in_every_use(tmp_path: Path) -> None:
    """The free body, compiled."""
    rows = measured(Store(tmp_path / "rows.json", ORIGIN), [SCALARS, PLAIN], FREE_BODY)
    assert len(rows) == 6
    for row in rows.values():
        assert row.done
        assert row.numbers["difference"] < 1e-13
        assert row.numbers["compile_seconds"] > 0.0


def test_a_package_that_is_not_there_is_absent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert CASADI.absent() == "casadi is not installed"


def test_c_of_casadi_gives_what_the_matrices_give() -> None:
    """Values and Jacobians, row by row, in all three uses."""
    pytest.importorskip("casadi")
    case = CASES["free-body"]
    for quantity in (VALUE, JACOBIAN):
        ours, task = PLAIN.task(case, quantity), CASADI.task(case, quantity)
        expected = values(ours.batch(3))
        assert relative_difference(values(task.batch(3)), expected, len(quantity.shape(case))) < 1e-13
        assert relative_difference(values(task.loop(5)), expected[0], len(quantity.shape(case))) < 1e-13
        assert relative_difference(values(task.single()), expected[0], len(quantity.shape(case))) < 1e-13


def test_c_in_vectors_gives_what_the_matrices_give() -> None:
    """Also where points are left for part of a vector, and by several threads."""
    pytest.importorskip("casadi")
    case = CASES["free-body"]
    for quantity, contender in ((VALUE, in_c("", "", 8, 2)), (JACOBIAN, CASADI_LANES)):
        task, expected = contender.task(case, quantity), values(PLAIN.task(case, quantity).batch(19))
        for count in (1, 19):
            results = values(task.batch(count))
            assert relative_difference(results, expected[:count], len(quantity.shape(case))) < 1e-13
        with pytest.raises(Lacks, match="8 points at a time"):
            task.single().result()


def test_numbers_of_c_become_vectors() -> None:
    c = "a0=arg[1]? arg[1][2] : 0;\n a1=-1.5e-3;\n a2=(a0*2.);\n if (res[0]!=0) res[0][1]=a2;"
    vectors = "a0=arg[1][2];\n a1=(casadi_real){}+-1.5e-3;\n a2=(a0*2.);\n if (res[0]!=0) res[0][1]=a2;"
    assert in_lanes(c) == vectors


def test_parts_of_a_result_are_joined_for_the_comparison_alone() -> None:
    """What is timed gives the rates of the pose and of the twist as they are: no copy that others do not make."""
    for contender in (SCALARS, PLAIN):
        program = contender.task(FREE_BODY, VALUE).batch(3)
        assert [part.shape for part in program.call()] == [(3, 7), (3, 6)]
        assert values(program).shape == (3, 13)


def by_hand(name: str, *arguments: Any) -> Any:
    return np.concatenate(CASES[name].by_hand(np, *arguments))


def test_forces_and_accelerations_are_inverse_to_each_other() -> None:
    q, qd, tau = (points[0] for points in CASES["aba-7"].points(1))
    accelerations = by_hand("aba-7", q, qd, tau)
    assert np.allclose(by_hand("rnea-7", q, qd, accelerations), tau, rtol=0.0, atol=1e-10)


def test_they_agree_with_ours() -> None:
    for name in ("free-body", "rnea-7"):
        case = CASES[name]
        dynamics = tx.compile(case.system(), backend=tx.XLA())
        # A quaternion of another length too: else derivatives by its entries would differ.
        point = [jnp.asarray(1.3 * points[0]) for points in case.points(1)]
        rates = jax.jit(lambda *point, case=case, dynamics=dynamics: dynamics(0.0, *case.inputs(*point)))(*point)
        ours = np.concatenate([rates[name] for name in case.rates])
        assert np.max(np.abs(by_hand(name, *map(np.asarray, point)) - ours)) < 1e-13 * np.max(np.abs(ours))
