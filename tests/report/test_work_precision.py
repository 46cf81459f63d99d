"""`python -m twistax report`, flown."""

import csv
import dataclasses
import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import twistax as tx
from twistax.__main__ import main
from twistax.report.turns import time_in_turn
from twistax.report.work_precision import command, flights
from twistax.report.work_precision.contender import Contender, Counts, Program
from twistax.report.work_precision.contenders import CONTENDERS
from twistax.report.work_precision.effort import QUICK, Effort
from twistax.report.work_precision.flights import measure_scene
from twistax.report.work_precision.ladder import Ladder, Tolerances
from twistax.report.work_precision.origin import Origin
from twistax.report.work_precision.progress import Progress
from twistax.report.work_precision.row import Row
from twistax.report.work_precision.store import Store
from twistax.scenes import SCENES, Scene

TOP = SCENES["euler-top"]
ORIGIN = Origin({"jax": "1"}, "abc", "a machine", {})
SHORT = dataclasses.replace(QUICK, tolerances=Tolerances(-6, -9, 1), rounds=4, least=2)


@dataclasses.dataclass(frozen=True)
class Pretended(Contender):
    """Knows the answer, and misses it by the tolerance."""

    name: str = "pretended"
    line: Any = CONTENDERS["tsit5"].line

    def ladder(self, effort: Effort) -> Ladder:
        return effort.tolerances

    def build(self, scene: Scene) -> Program:
        def fly(start: Any, tolerance: jax.Array) -> tuple[Any, Counts]:
            good = tolerance > 3e-9
            return start["w"] + tolerance, Counts(jnp.asarray(3), jnp.asarray(1), jnp.asarray(24), good)

        return Program({"w": jnp.asarray(scene.end["w"])}, fly, lambda w: {**scene.end, "w": w}, True)


def quiet(what: str, share: float) -> None:
    pass


def test_a_run_leaves_tables_figures_and_a_page_and_goes_on_where_it_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["report", "--quick", "--scene", "euler-top", "--out", str(tmp_path)]
    words += ["--method", "dop853-quaternion", "--method", "diffrax-tsit5-call"]
    assert main(words) == 0
    said = capsys.readouterr()
    assert said.err == ""  # no bar where there is no terminal
    assert "18 flights" in said.out
    assert "bar       euler-top    dop853-quaternion" in said.out

    with (tmp_path / "report.csv").open() as file:
        table = list(csv.DictReader(file))
    assert len(table) == 18
    for method in ("dop853-quaternion", "diffrax-tsit5-call"):
        errors = [float(row["error"]) for row in table if row["method"] == method]
        assert min(errors) < 1e-9 < 1e-5 < max(errors)
    assert all(float(row["seconds"]) >= float(row["fastest"]) > 0.0 for row in table)
    assert all(int(row["steps"]) == int(row["accepted"]) + int(row["rejected"]) > 10 for row in table)
    for row in table:
        # Tsit5 takes six a step and one at the start; DOP853 twelve, one fewer for a step that is tried again.
        low, high = (6, 6) if row["method"] == "diffrax-tsit5-call" else (11, 12)
        steps = int(row["steps"])
        assert low * steps < int(row["evaluations"]) <= high * steps + 3
        assert 1e-2 < float(row["compile_seconds"]) < 60.0

    document = json.loads((tmp_path / "report.json").read_text())
    assert len(document["rows"]) == 18
    fastest = min((t for t in document["times"] if t["error"] == 1e-6), key=lambda t: t["seconds"])
    for page in ("report.md", "report.html"):
        text = (tmp_path / page).read_text()
        assert f"(6 digits). Fastest: {fastest['line']} on Euler top." in text
        assert document["machine"] in text
    assert (tmp_path / "figures/euler-top.svg").stat().st_size < 150_000

    # The same again flies nothing; where rows are missing, only those are flown.
    monkeypatch.setattr(flights, "_Launch", pytest.fail)
    assert main(words) == 0
    assert "0 flights" in capsys.readouterr().out
    monkeypatch.undo()
    lines = (tmp_path / "rows.jsonl").read_text().splitlines()
    (tmp_path / "rows.jsonl").write_text("\n".join([*lines[:-1], lines[-1][:40]]))
    assert main(words) == 0
    said = capsys.readouterr()
    assert "1 of other versions" in said.out
    assert " 1 flights" in said.out
    assert (tmp_path / "report.csv").read_text().count("\n") == 19

    # Without matplotlib everything but the figures is there.
    def absent(*_: Any) -> bytes:
        raise ImportError("matplotlib")

    monkeypatch.setattr(command, "draw", absent)
    assert main(words) == 0
    assert "get it with pip install 'twistax[plot]'" in capsys.readouterr().out
    assert "No figures: they need matplotlib" in (tmp_path / "report.md").read_text()


def test_a_wrong_answer_ends_in_status_1(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    end = {name: np.array(value) for name, value in TOP.end.items()}
    end["w"][0] += 1e-3
    wrong = dataclasses.replace(TOP, exact=None, reference=end)
    monkeypatch.setattr(command, "SCENES", {"euler-top": wrong})
    told = ["report", "--quick", "--scene", "euler-top", "--method", "diffrax-tsit5-call", "--out", str(tmp_path)]
    assert main(told) == 1
    assert "IT DISAGREES" in capsys.readouterr().out
    assert "Not all methods were seen to find the same end" in (tmp_path / "report.md").read_text()


def test_rows_say_what_happened(tmp_path: Path) -> None:
    store = Store(tmp_path / "rows.jsonl", ORIGIN, Row.of)
    assert measure_scene(TOP, [Pretended()], SHORT, store, quiet) == []
    rows = {row.setting: row for row in store}
    assert list(rows) == [1e-6, 1e-7, 1e-8, 1e-9]
    size = float(np.linalg.norm(TOP.end["w"]))
    assert rows[1e-6].error == pytest.approx(np.sqrt(3.0) * 1e-6 / max(1.0, size), rel=1e-6)
    assert rows[1e-6].repeats == 12
    assert (rows[1e-6].steps, rows[1e-6].rejected, rows[1e-6].evaluations) == (4, 1, 24)
    assert np.isnan(rows[1e-9].error)
    assert np.isnan(rows[1e-9].seconds)
    assert rows[1e-9].result == "did not reach the end"
    again = Store(tmp_path / "rows.jsonl", ORIGIN, Row.of)
    assert [row.record() for row in again] == [row.record() for row in store]


def test_rows_of_other_versions_are_dropped(tmp_path: Path) -> None:
    store = Store(tmp_path / "rows.jsonl", ORIGIN, Row.of)
    measure_scene(TOP, [Pretended()], SHORT, store, quiet)
    for change in ({"versions": {"jax": "2"}}, {"code": "abd"}, {"machine": "another"}, {"effort": {"rounds": 5}}):
        other = Store(tmp_path / "rows.jsonl", dataclasses.replace(ORIGIN, **change), Row.of)
        assert (len(other), other.dropped) == (0, 4)
        other.add(store)


def test_a_method_that_cannot_fly_a_scene_is_named(tmp_path: Path) -> None:
    class Refusing(Pretended):
        def build(self, scene: Scene) -> Program:
            raise tx.ModelError("the rate depends on the pose\n  fix: another method")

    (refused,) = measure_scene(TOP, [Refusing()], SHORT, Store(tmp_path / "rows.jsonl", ORIGIN, Row.of), quiet)
    assert (refused.scene, refused.reason) == ("euler-top", "the rate depends on the pose")


def test_flights_take_turns() -> None:
    """Long ones in some of the rounds; a short one in bursts, whose first call, with cold caches, does not count."""
    order: list[str] = []

    def flight(name: str, rough: float) -> Any:
        row = flights.Row(name, name, "steps", 1.0, 0.0, 0.0, 0.0, 0, 0.0, 0, 0, 0, "done", "now")
        return flights._Flight(row, lambda: order.append(name), rough)

    effort = dataclasses.replace(QUICK, rounds=6, least=3, share=0.05)
    taking = [flight("a", 1.0), flight("b", 1.0), flight("c", 6e-3), flight("d", 1e-3)]
    time_in_turn(taking, effort, quiet)
    assert "".join(order) == 3 * "cddddabcdddd"
    assert [len(each.samples) for each in taking] == [3, 3, 6, 18]


def test_diffrax_in_one_call_is_compiled_as_one_small_function() -> None:
    """Otherwise the comparison would flatter us."""
    for name, small in (("diffrax-tsit5-call", True), ("diffrax-tsit5", False)):
        program = CONTENDERS[name].build(TOP)
        text = jax.jit(program.fly).lower(program.start, jnp.asarray(1e-6)).compile().as_text()
        assert ('inlineable="false"' in text) == small


NONSENSE = {
    "--scene moon": "there is no scene 'moon'; there are euler-top, ",
    "--method rk5": "there is no method 'rk5'; there are rk4, ",
    "--fast": "unrecognized arguments: --fast",
}


@pytest.mark.parametrize("words", NONSENSE)
def test_nonsense_ends_in_one_clear_line(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["report", *words.split()])
    said = capsys.readouterr().err
    assert ended.value.code == 2
    assert said.count("\n") == 1
    assert NONSENSE[words] in said


def test_a_folder_that_cannot_be_made(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("")
    assert main(["report", "--out", str(tmp_path / "file")]) == 2
    assert "cannot write" in capsys.readouterr().err


@pytest.mark.parametrize(("terminal", "shown"), [(True, True), (True, False), (False, True)])
def test_the_bar_is_for_terminals(terminal: bool, shown: bool) -> None:
    stream = io.StringIO()
    stream.isatty = lambda: terminal  # type: ignore[method-assign]
    progress = Progress(stream, 2, shown)
    progress.start("euler-top")
    progress.tell("timing", 0.5)
    progress.end()
    assert (" 25% " in stream.getvalue() and "euler-top  timing" in stream.getvalue()) == (terminal and shown)


def test_an_interrupted_run_says_how_to_go_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupt(*_: Any) -> Callable[[], None]:
        raise KeyboardInterrupt

    monkeypatch.setattr(command, "measure_scene", interrupt)
    assert main(["report", "--out", str(tmp_path)]) == 130
    assert "interrupted; the same command goes on" in capsys.readouterr().err
