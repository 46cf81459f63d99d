"""`python -m twistax report --speed`: what agrees is timed, what is missing is named."""

import csv
import dataclasses
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from twistax.__main__ import main
from twistax.report.speed import command, figure, page
from twistax.report.speed.case import CASES, Case, FreeBody
from twistax.report.speed.contender import Contender
from twistax.report.speed.effort import QUICK
from twistax.report.speed.measure import apart, measure
from twistax.report.speed.own import Scalars
from twistax.report.speed.peers.casadi import Casadi
from twistax.report.speed.peers.plain_jax import PlainJax
from twistax.report.speed.quantity import JACOBIAN, VALUE, Quantity
from twistax.report.speed.row import Row
from twistax.report.speed.task import Lacks, Program, Task
from twistax.report.speed.use import LOOP, SINGLE, Batch
from twistax.report.work_precision.origin import Origin
from twistax.report.work_precision.store import Store

ORIGIN = Origin({"jax": "1"}, "abc", "a machine", {})
SHORT = dataclasses.replace(QUICK, cases=("free-body",), largest=64, rounds=2, least=1, share=1e-3)


class Pretending(Task):
    """Results that are ones, off by a factor; some uses may be refused."""

    def __init__(self, shape: tuple[int, ...], factor: float, seconds: float, refuses: str) -> None:
        self._shape, self._factor, self._seconds, self._refuses = shape, factor, seconds, refuses

    def _program(self, evaluations: int, *points: int) -> Program:
        return Program(lambda: np.full((*points, *self._shape), self._factor), evaluations, self._seconds)

    def single(self) -> Program:
        return self._program(1)

    def loop(self, steps: int) -> Program:
        if self._refuses == "loop":
            raise Lacks("it has no loop")
        return self._program(steps)

    def batch(self, count: int) -> Program:
        return self._program(count, count)


class Pretender(Contender):
    how, colour = "pretends", "C0"

    def __init__(
        self, name: str, factor: float = 1.0, gone: str | None = None, seconds: float = 0.1, refuses: str = ""
    ) -> None:
        self.name, self.factor, self.gone, self.seconds, self.refuses = name, factor, gone, seconds, refuses

    def absent(self) -> str | None:
        return self.gone

    def task(self, case: Case, quantity: Quantity) -> Task:
        return Pretending(quantity.shape(case), self.factor, self.seconds, self.refuses)


Announce = Callable[[Sequence[Contender]], None]


@pytest.fixture
def taking_part(monkeypatch: pytest.MonkeyPatch) -> Announce:
    """Call it with those who take part."""
    monkeypatch.setattr(command, "QUICK", SHORT)

    def announce(contenders: Sequence[Contender]) -> None:
        for module in (command, page, figure):
            monkeypatch.setattr(module, "CONTENDERS", tuple(contenders))

    return announce


def test_a_run_says_who_is_absent_and_who_disagrees(
    tmp_path: Path, taking_part: Announce, capsys: pytest.CaptureFixture[str]
) -> None:
    gone = Pretender("gone", gone="gone is not installed")
    taking_part([Pretender("ours"), Pretender("plain JAX", 1 + 1e-12), Pretender("wrong", 1 + 1e-6), gone])
    words = ["report", "--speed", "--quick", "--out", str(tmp_path)]
    assert main(words) == 1
    said = capsys.readouterr().out
    assert "absent    gone: gone is not installed" in said
    assert "doubt     wrong disagrees by 1e-06: free-body value in a loop" in said

    with (tmp_path / "speed.csv").open() as file:
        table = list(csv.DictReader(file))
    assert {row["contender"] for row in table} == {"ours", "plain JAX", "wrong"}
    assert len(table) == 3 * 3  # a call, a loop, a batch of 64
    for row in table:
        timed = row["contender"] != "wrong"
        assert (row["result"] == "done") == timed
        assert (row["median"] != "") == timed
        if timed:
            assert 0.0 < float(row["fastest"]) <= float(row["lower"]) <= float(row["median"]) <= float(row["upper"])
    document = json.loads((tmp_path / "speed.json").read_text())
    assert document["absent"] == {"gone": "gone is not installed"}
    assert len(document["rows"]) == 9
    for name in ("speed.md", "speed.html"):
        text = (tmp_path / name).read_text()
        assert "gone is absent" in text
        assert "Not all results agree" in text
        assert document["machine"] in text
        assert "no XLA flag" in text
    assert (tmp_path / "figures/speed-value.svg").stat().st_size < 100_000


def test_what_was_measured_is_kept_until_somebody_joins(
    tmp_path: Path, taking_part: Announce, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["report", "--speed", "--quick", "--out", str(tmp_path)]
    taking_part([Pretender("ours"), Pretender("plain JAX")])
    assert main(words) == 0
    assert "6 rows" in capsys.readouterr().out
    lines = (tmp_path / "speed-rows.jsonl").read_text().splitlines()
    (tmp_path / "speed-rows.jsonl").write_text("\n".join(lines[:-2]) + "\n")
    assert main(words) == 0
    assert "   2 rows" in capsys.readouterr().out  # the last use, in which two rows were missing
    assert main(words) == 0
    assert "   0 rows" in capsys.readouterr().out


def measured(store: Store[Row], contenders: Sequence[Contender], case: Case = CASES["free-body"]) -> dict[Any, Row]:
    measure(case, VALUE, [SINGLE, LOOP, Batch(8)], contenders, SHORT, store, lambda what, share: None)
    return {(row.contender, row.use): row for row in store}


def test_what_would_take_too_long_is_left_out(tmp_path: Path) -> None:
    """It goes by the batch before; calls from Python and loops say nothing of a batch."""
    store, hurried = Store(tmp_path / "rows.jsonl", ORIGIN, Row.of), dataclasses.replace(SHORT, longest=1e-12)
    uses = [SINGLE, Batch(64), Batch(4096)]
    measure(CASES["free-body"], VALUE, uses, [Pretender("ours")], hurried, store, lambda what, share: None)
    results = {row.use: row.result for row in store}
    assert [results[use.name] for use in uses] == ["done", "done", "a call would take 0 s"]


def test_a_use_that_is_refused_says_why(tmp_path: Path) -> None:
    store = Store(tmp_path / "rows.jsonl", ORIGIN, Row.of)
    rows = measured(store, [Pretender("ours"), Pretender("peer", refuses="loop")])
    assert rows["peer", "in a loop"].result == "it has no loop"
    assert rows["peer", "batch of 8"].done
    again = Store(tmp_path / "rows.jsonl", ORIGIN, Row.of)
    assert len(again) == 6
    assert again.get("free-body", "value", "single call", "ours") == rows["ours", "single call"]


def test_what_compiles_for_too_long_is_not_compiled_again(tmp_path: Path) -> None:
    store = Store(tmp_path / "rows.jsonl", ORIGIN, Row.of)
    rows = measured(store, [Pretender("ours"), Pretender("slow", seconds=SHORT.patience + 1.0)])
    assert rows["slow", "single call"].done
    assert rows["slow", "in a loop"].result == f"compiling another use took {SHORT.patience + 1.0:.0f} s"


def test_a_failure_of_a_peer_ends_its_row_alone(tmp_path: Path) -> None:
    class Failing(Pretender):
        def task(self, case: Case, quantity: Quantity) -> Task:
            raise RuntimeError("RESOURCE_EXHAUSTED: Out of memory\nand more")

    rows = measured(Store(tmp_path / "rows.jsonl", ORIGIN, Row.of), [Pretender("ours"), Failing("peer")])
    assert rows["peer", "in a loop"].result == "failed: RESOURCE_EXHAUSTED: Out of memory"
    assert rows["ours", "in a loop"].done


def test_the_difference_is_relative_to_the_largest_entry_of_a_point() -> None:
    reference = np.array([[1.0, 2.0], [100.0, 0.0]])
    assert apart(reference, reference, 1) == 0.0
    assert apart(reference + np.array([[0.0, 0.0], [0.0, 1.0]]), reference, 1) == pytest.approx(1e-2)
    assert apart(reference + np.array([[1.0, 0.0], [0.0, 0.0]]), reference, 1) == pytest.approx(0.5)
    assert apart(reference[:, :1], reference, 1) == np.inf
    assert apart(np.full((2, 2), np.nan), reference, 1) == np.inf


def test_ours_and_plain_jax_agree_in_every_use(tmp_path: Path) -> None:
    """The free body, compiled."""
    rows = measured(Store(tmp_path / "rows.jsonl", ORIGIN, Row.of), [Scalars(), PlainJax()], FreeBody())
    assert len(rows) == 6
    for row in rows.values():
        assert row.done
        assert row.difference < 1e-13
        assert row.compile_seconds > 0.0


def test_a_package_that_is_not_there_is_absent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert Casadi().absent() == "casadi is not installed"


def test_c_of_casadi_gives_what_the_matrices_give() -> None:
    """Values and Jacobians, row by row, in all three uses."""
    pytest.importorskip("casadi")
    case = CASES["free-body"]
    for quantity in (VALUE, JACOBIAN):
        ours, task = PlainJax().task(case, quantity), Casadi().task(case, quantity)
        expected = ours.batch(3).values()
        assert apart(task.batch(3).values(), expected, len(quantity.shape(case))) < 1e-13
        assert apart(task.loop(5).values(), expected[0], len(quantity.shape(case))) < 1e-13
        assert apart(task.single().values(), expected[0], len(quantity.shape(case))) < 1e-13


def test_parts_of_a_result_are_joined_for_the_comparison_alone() -> None:
    """What is timed gives the rates of the pose and of the twist as they are: no copy that others do not make."""
    for contender in (Scalars(), PlainJax()):
        program = contender.task(FreeBody(), VALUE).batch(3)
        assert [part.shape for part in program.call()] == [(3, 7), (3, 6)]
        assert program.values().shape == (3, 13)


def test_an_unknown_case_ends_in_one_clear_line(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["report", "--speed", "--case", "moon"])
    assert ended.value.code == 2
    assert "there is no case 'moon'; there are free-body, " in capsys.readouterr().err
