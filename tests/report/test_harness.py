"""What all reports share: rows and their store, timing in turn, checks and their bars, the command, the pages."""

import argparse
import csv
import dataclasses
import io
import json
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import twistax as tx
from twistax import progress
from twistax.__main__ import main
from twistax.report import command
from twistax.report.command import run_report
from twistax.report.harness.expected import Absent, EarlyEnd, at_most, between, either, ends, refused, simulated
from twistax.report.harness.measurement import MeasuredCase, explained, quick, table
from twistax.report.harness.page import PageFigure, render, renew, table_of, texts
from twistax.report.harness.report import SectionReport, draw
from twistax.report.harness.rows import ReportRow, duration, number, plain
from twistax.report.harness.store import Origin, Store, save_csv
from twistax.report.harness.timing import Race, Repeats, Timed, agree, compiled, in_turn
from twistax.report.registry import FIGURES, OPTIMAL, STABILITY

LOST = tx.IntegrationError("state 'x' became infinite\n  fix: none")
ORIGIN = Origin({"jax": "1"}, "abc", "a machine", {})

# ---- rows and their store --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "text"), [(1e5, "1e5"), (1e-12, "1e-12"), (0.05, "0.05"), (500.0, "500"), (0.0, "0")]
)
def test_round_numbers(value: float, text: str) -> None:
    assert plain(value) == text


def test_measured_numbers_have_two_or_three_digits() -> None:
    assert [number(v) for v in (1501.0, 27240.6, 0.2345, 1.234e-6, 0.0)] == ["1,501", "27,241", "0.234", "1.2e-6", "0"]
    assert [duration(v) for v in (2.0, 1.5e-3, 4.2e-5, math.nan)] == ["2 s", "1.5 ms", "42 us", "-"]


def test_rows_come_back_from_disk_until_something_else_is_measured(tmp_path: Path) -> None:
    path = tmp_path / "rows.json"
    row = ReportRow("scene", "one call", "RK4", "steps 8", math.nan, "s", numbers={"error": 1e-3, "fastest": math.nan})
    Store(path, ORIGIN).add([row])
    again = Store(path, ORIGIN)
    assert (len(again), again.dropped) == (1, 0)
    found = again.get("scene", "one call", "RK4", "steps 8")
    assert math.isnan(found.value)
    assert found.numbers["error"] == 1e-3
    assert math.isnan(found.numbers["fastest"])
    for change in ({"versions": {"jax": "2"}}, {"code": "abd"}, {"machine": "another"}, {"effort": {"rounds": 5}}):
        other = Store(path, dataclasses.replace(ORIGIN, **change))
        assert (len(other), other.dropped) == (0, 1)
    path.write_text(path.read_text()[:60])
    assert len(Store(path, ORIGIN)) == 0


def test_a_table_has_each_column_once(tmp_path: Path) -> None:
    save_csv(
        tmp_path / "rows.csv",
        [ReportRow("scene", "one call", "RK4", "steps 8", 1.0, numbers={"setting": 8.0, "error": 2.0})],
    )
    head, row = (line.split(",") for line in (tmp_path / "rows.csv").read_text().splitlines())
    assert len(set(head)) == len(head)
    assert (row[head.index("setting")], row[head.index("error")]) == ("steps 8", "2")


# ---- timing ----------------------------------------------------------------------------------------------------------


def test_competitors_take_turns() -> None:
    """Long ones in some of the rounds; a short one in bursts, whose first call, with cold caches, does not count."""
    order: list[str] = []
    timed = {
        n: Timed(lambda n=n: order.append(n), rough=r) for n, r in {"a": 1.0, "b": 1.0, "c": 6e-3, "d": 1e-3}.items()
    }
    in_turn(list(timed.values()), Repeats(rounds=6, least=3, share=0.05))
    assert "".join(order) == 3 * "cddddabcdddd"
    assert [len(each.samples) for each in timed.values()] == [3, 3, 6, 18]


def test_times_are_medians_of_an_evaluation() -> None:
    timed = Timed(lambda: None, evaluations=10, samples=[3.0, 1.0, 2.0])
    assert timed.seconds == 0.2
    assert timed.numbers == {"lower": 0.15, "upper": 0.25, "fastest": 0.1, "repeats": 3.0}
    run = compiled(lambda x: x + 1.0, np.ones(3))
    assert run.compile_seconds > 0.0
    np.testing.assert_array_equal(run.result(), [2.0, 2.0, 2.0])


# ---- what counts -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "expected", [between(), at_most(1.0), between(1.0), ends(tx.Result.SUCCESS), refused(tx.InputError, "")]
)
@pytest.mark.parametrize("found", [math.nan, math.inf, LOST, TypeError()])
def test_nan_and_unforeseen_failures_are_never_what_was_asked_for(expected: Any, found: float | Exception) -> None:
    assert not expected.met(found)


def test_numbers_are_held_against_bars() -> None:
    assert at_most(1e-3).met(1e-3)
    assert not at_most(1e-3).met(1.1e-3)
    assert between(4.0).met(4.0)
    assert not between(4.0).met(3.9)
    assert between(4.8, 5.2).text == "at least 4.8, at most 5.2"
    assert either(at_most(1.0), ends(tx.Result.MAX_STEPS)).met(EarlyEnd(tx.Result.MAX_STEPS, 0.1))
    assert not either(at_most(1.0), ends(tx.Result.MAX_STEPS)).met(2.0)


def test_an_end_needs_its_name_and_its_time() -> None:
    expected = ends(tx.Result.NON_FINITE, 0.9, 1.1)
    assert expected.met(EarlyEnd(tx.Result.NON_FINITE, 1.0))
    assert not expected.met(EarlyEnd(tx.Result.NON_FINITE, 1.2))
    assert not expected.met(EarlyEnd(tx.Result.MAX_STEPS, 1.0))


def test_an_error_needs_its_type_and_its_words_in_the_first_line() -> None:
    assert refused(tx.IntegrationError, "'x' became infinite").met(LOST)
    assert not refused(tx.IntegrationError, "fix").met(LOST)
    assert not refused(tx.InputError, "'x' became infinite").met(LOST)


def test_an_integration_that_ends_early_raises_how_and_when() -> None:
    x = tx.State("x")
    growing = tx.compile(tx.System(rates={x: x * x}))
    with pytest.raises(EarlyEnd, match="NON_FINITE at t = 1") as ended:
        simulated(growing, {"x": 1.0}, t1=2.0, dt=0.02)
    assert ended.value.result is tx.Result.NON_FINITE


def test_results_must_agree_before_times_count() -> None:
    agree(1e-12, 1e-9)
    for size in (1e-8, math.nan):
        with pytest.raises(RuntimeError, match="DISAGREES by"):
            agree(size, 1e-9)


def test_a_race_compares_first_and_is_run_once() -> None:
    calls: list[str] = []

    def programs(error: float) -> dict[str, Timed]:
        calls.append("made")
        return {"one": Timed(lambda: np.ones(2)), "two": Timed(lambda: np.array([1.0, 1.0 + error]), 2)}

    race = Race(lambda: programs(1e-10), 1e-9, Repeats(2, 1))
    assert race.ratio("two", "one") == race.seconds("two") / race.seconds("one")
    assert race.seconds("one", 1e-3) == pytest.approx(1e3 * race.seconds("one"))
    assert calls == ["made"]
    assert race.programs["two"].samples
    for error in (1e-8, math.nan):
        with pytest.raises(RuntimeError, match="DISAGREES by"):
            Race(lambda error=error: programs(error), 1e-9, Repeats(2, 1)).ratio("two", "one")


# ---- a report of checks ----------------------------------------------------------------------------------------------


def raising(error: Exception) -> Callable[[], float]:
    def measure() -> float:
        raise error

    return measure


def section(*more: MeasuredCase) -> list[str | MeasuredCase]:
    lost = raising(EarlyEnd(tx.Result.NON_FINITE, 0.5))
    return [
        "Short steps.",
        MeasuredCase("a small error", "RK4", at_most(1e-8), lambda: 2e-9, place=("RK4", 1.0)),
        "Long steps.",
        MeasuredCase("a larger one", "RK4", at_most(1e-4), lambda: 2e-5, place=("RK4", 10.0)),
        "Too long steps.",
        MeasuredCase("too far | beyond", "RK4", ends(tx.Result.NON_FINITE), lost, slow=True, place=("RK4", 100.0)),
        "For a test.",
        *more,
    ]


SILENT = MeasuredCase("a silent one", "RK4", at_most(1.0), lambda: math.nan)
ABSENT = MeasuredCase("needs a package", "none", at_most(1.0), raising(Absent("not run: it is not installed")))
BROKEN = MeasuredCase("without a bar", "RK4", between(), raising(RuntimeError("DISAGREES by 1.0e-03")))


def run(
    folder: Path,
    *more: MeasuredCase,
    quick: bool = False,
    again: bool = False,
    renew: Any = None,
    only: Any = None,
    no_progress: bool = True,
) -> int:
    given = argparse.Namespace(
        out=folder,
        quick=quick,
        again=again,
        renew=renew,
        no_progress=no_progress,
        only=only,
        stability=True,
        speed=False,
        figures=False,
        scene=None,
        method=None,
        case=None,
    )
    return run_report(SectionReport("stability", {"long": section(*more)}, given), given)


def test_a_run_writes_page_figure_and_tables_and_goes_on(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(tmp_path, quick=True) == 0
    assert "long                  2 rows" in capsys.readouterr().out
    assert run(tmp_path) == 0
    assert "long                  1 rows" in capsys.readouterr().out  # those that were there are kept
    assert run(tmp_path, again=True) == 0
    assert "long                  3 rows" in capsys.readouterr().out
    with (tmp_path / "stability.csv").open() as file:
        table = list(csv.DictReader(file))
    assert [row["holds"] for row in table] == ["True"] * 3
    assert len(json.loads((tmp_path / "stability.json").read_text())["rows"]) == 3
    markdown, page = ((tmp_path / f"stability.{kind}").read_text() for kind in ("md", "html"))
    for text in (markdown, page):
        assert "All 3 rows are what was asked for. No row ended with NaN" in text
        assert "Too long steps." in text
        assert "NON_FINITE at t = 0.5 s" in text
        assert "python -m twistax report --stability --out" in text
    assert "figures/stability-long.svg" in markdown
    assert "too far \\| beyond" in markdown
    assert "data:image/svg+xml" in page
    assert (tmp_path / "figures/stability-long.svg").exists()


def test_a_bar_that_fails_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(tmp_path, SILENT, BROKEN) == 1
    said, markdown = capsys.readouterr().out, (tmp_path / "stability.md").read_text()
    assert "doubt     a silent one (RK4): NaN OR INFINITE, AND NOTHING SAID SO; asked for: at most 1" in said
    assert "without a bar (RK4): RuntimeError: DISAGREES by 1.0e-03" in said
    assert "**2 of 5 rows are not what was asked for**" in markdown
    assert "1 rows ended with NaN" in markdown
    assert markdown.count("MISSED") == 2


def test_what_is_not_installed_is_named_and_no_failure(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(tmp_path, ABSENT) == 0
    assert "not run: it is not installed" in (tmp_path / "stability.md").read_text()
    assert "1 rows were not run" in (tmp_path / "stability.md").read_text()
    assert run(tmp_path, ABSENT) == 0  # looked for again
    assert "long                  0 rows" in capsys.readouterr().out.split("time")[1]


def test_without_matplotlib_everything_but_the_figures_is_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    assert run(tmp_path) == 0
    assert "get it with pip install 'twistax[plot]'" in capsys.readouterr().out
    assert "No figures: they need matplotlib" in (tmp_path / "stability.md").read_text()


def test_the_figure_shows_numbers_and_ends() -> None:
    placed = [(check.run(), check.place) for check in section() if isinstance(check, MeasuredCase)]
    text = draw(placed, {"title": "Made up", "axes": ["step", "error"]}).decode()
    assert "Made up" in text
    assert "x: ends by name" in text


def test_a_wide_table_has_a_column_for_each_contender_and_bars_they_share_in_its_head() -> None:
    rows = [
        ReportRow("g", "exp", "float64", value=2.0, unit="ulp", bar="at most 8 ulp", holds=True),
        ReportRow("g", "log", "float64", value=9.0, unit="ulp", bar="at most 8 ulp", holds=False),
        ReportRow("g", "log", "float32", value=3.0, unit="ulp"),
    ]
    head, table, _ = table_of(rows, wide=True)
    assert head == ["", "float64 (at most 8 ulp)", "float32"]
    assert table == [["exp", "2 ulp", ""], ["log", "**9 ulp MISSED**", "3 ulp"]]


def test_a_table_measures_each_column_of_each_row() -> None:
    columns = {"double": (at_most(5.0), lambda x: 2.0 * x), "off": (lambda x: at_most(x - 2.0), lambda x: abs(x))}
    rows = [it.run("g") for it in table({"two": 2.0, "three": 3.0}, columns, quick)]
    assert [(row.what, row.by, row.came, row.bar, row.verdict) for row in rows] == [
        ("two", "double", "4", "at most 5", "holds"),
        ("two", "off", "2", "at most 0", "MISSED"),
        ("three", "double", "6", "at most 5", "MISSED"),
        ("three", "off", "3", "at most 1", "MISSED"),
    ]
    assert all(it.slow for it in table({"two": 2.0}, columns))


def test_every_section_has_words_and_every_word_a_section() -> None:
    for report, sections in (("stability", STABILITY), ("figures", FIGURES), ("optimal", OPTIMAL)):
        assert set(texts(report)["sections"]) == set(sections)
        assert all(list(explained(section)) for section in sections.values())


# ---- pages -----------------------------------------------------------------------------------------------------------


def test_a_page_is_safe_html_and_plain_markdown() -> None:
    table = (["name", "value"], [["a | `x < 1`", "**1**"]], 1)
    markdown, page = render("table", {"title": "a < b", "table": table})
    assert markdown == "| name | value |\n| --- | ---: |\n| a \\| `x < 1` | **1** |\n"
    assert "<title>a &lt; b</title>" in page
    assert '<td class="word">a | <code>x &lt; 1</code></td><td><strong>1</strong></td>' in page
    assert "http" not in page
    assert PageFigure("a.svg", b"<svg/>").data.startswith("data:image/svg+xml;base64,")


def test_tables_of_a_document_are_renewed_and_its_prose_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "measured.md"
    path.write_text(
        "Before.\n\n<!-- figures: a -->\nold\n<!-- end -->\n\nAfter.\n\n<!-- figures: b -->\nkept\n<!-- end -->\n"
    )
    assert renew(path, {"figures: a": (["x"], [["1"]], 1), "figures: c": (["x"], [["2"]], 1)}) == ["figures: a"]
    text = path.read_text()
    assert "Before.\n\n<!-- figures: a -->\n\n| x |\n| --- |\n| 1 |\n\n<!-- end -->\n\nAfter." in text
    assert "kept" in text
    assert "old" not in text
    renew(path, {"figures: a": (["x"], [["1"]], 1)})
    assert path.read_text() == text


def test_only_whole_tables_are_put_into_a_document(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A run of some sections renews those; a whole one also what other whole runs left in the folder."""
    document, stale = tmp_path / "measured.md", "stale\n<!-- end -->\n"
    document.write_text(f"<!-- stability: long -->\n{stale}<!-- figures: a -->\n{stale}<!-- speed: bars -->\n{stale}")
    for name, group, whole in (("figures", "a", True), ("speed", "bars", False)):
        store = Store(tmp_path / f"{name}.json", ORIGIN)
        store.save([ReportRow(group, "it", "us", value=3.0)], whole)
    assert run(tmp_path, renew=document, only=["long"]) == 0
    assert "renewed   " in (told := capsys.readouterr().out)
    assert "measured.md: stability: long\n" in told
    assert document.read_text().count("stale") == 2
    assert run(tmp_path, renew=document) == 0
    assert "measured.md: stability: long, figures: a\n" in capsys.readouterr().out
    assert document.read_text().endswith(f"<!-- speed: bars -->\n{stale}")
    for words, named in (
        ("--figures --quick", "--quick"),
        ("--speed --case aba-7", "--case"),
        ("--scene rocket", "--scene"),
    ):
        assert main(["report", *words.split(), "--renew", str(document)]) == 2
        assert f"--renew writes whole tables; leave out {named}\n" in capsys.readouterr().err


@pytest.mark.parametrize(("terminal", "hidden"), [(True, False), (True, True), (False, False)])
def test_the_progress_bar_is_for_terminals(
    terminal: bool, hidden: bool, tmp_path: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(progress, "_LIVE", 0.0)
    stream = io.StringIO()
    stream.isatty = lambda: terminal  # type: ignore[method-assign]
    monkeypatch.setattr(command.sys, "stderr", stream)
    run(tmp_path, no_progress=hidden)
    assert (" of all, long: " in stream.getvalue()) == (terminal and not hidden)


# ---- the command -----------------------------------------------------------------------------------------------------
