"""`python -m twistax report --stability`: what counts as expected, the page, and the command."""

import csv
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import twistax as tx
from twistax.__main__ import main
from twistax.report.stability import command
from twistax.report.stability.figure import draw
from twistax.report.stability.outcome import Outcome
from twistax.report.stability.page import page
from twistax.report.stability.row import (
    AtLeast,
    AtMost,
    Either,
    Ended,
    Ends,
    Found,
    Place,
    Refused,
    Row,
    Section,
    flown,
    plain,
)
from twistax.report.work_precision.blocks import as_html, as_markdown

LOST = tx.IntegrationError("state 'x' became infinite\n  fix: none")


# ---- what counts ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("expected", [AtMost(1.0), AtLeast(1.0), Ends(tx.Result.SUCCESS), Refused(tx.InputError, "")])
@pytest.mark.parametrize("found", [Found(math.nan), Found(math.inf), Found(failure=LOST), Found(failure=TypeError())])
def test_no_number_and_no_unforeseen_failure_is_ever_expected(expected: Any, found: Found) -> None:
    assert not expected.met(found)


def test_numbers_are_held_against_bars() -> None:
    assert AtMost(1e-3).met(Found(1e-3))
    assert not AtMost(1e-3).met(Found(1.1e-3))
    assert AtLeast(4.0).met(Found(4.0))
    assert not AtLeast(4.0).met(Found(3.9))
    assert Either(AtMost(1.0), Ends(tx.Result.MAX_STEPS)).met(Found(failure=Ended(tx.Result.MAX_STEPS, 0.1)))
    assert not Either(AtMost(1.0), Ends(tx.Result.MAX_STEPS)).met(Found(2.0))


def test_an_end_needs_its_name_and_its_time() -> None:
    expected = Ends(tx.Result.NON_FINITE, 0.9, 1.1)
    assert expected.met(Found(failure=Ended(tx.Result.NON_FINITE, 1.0)))
    assert not expected.met(Found(failure=Ended(tx.Result.NON_FINITE, 1.2)))
    assert not expected.met(Found(failure=Ended(tx.Result.MAX_STEPS, 1.0)))


def test_an_error_needs_its_type_and_its_words_in_the_first_line() -> None:
    assert Refused(tx.IntegrationError, "'x' became infinite").met(Found(failure=LOST))
    assert not Refused(tx.IntegrationError, "fix").met(Found(failure=LOST))
    assert not Refused(tx.InputError, "'x' became infinite").met(Found(failure=LOST))


def test_a_flight_that_ends_early_raises_how_and_when() -> None:
    x = tx.State("x")
    growing = tx.compile(tx.System(rates={x: x * x}))
    with pytest.raises(Ended, match="NON_FINITE at t = 1") as ended:
        flown(growing, {"x": 1.0}, t1=2.0, dt=0.02)
    assert ended.value.result is tx.Result.NON_FINITE


@pytest.mark.parametrize(
    ("number", "text"), [(1e5, "1e5"), (1e-12, "1e-12"), (0.05, "0.05"), (500.0, "500"), (0.0, "0")]
)
def test_plain_numbers(number: float, text: str) -> None:
    assert plain(number) == text


# ---- page, figure and command ----------------------------------------------------------------------------------------


def raising(error: Exception) -> Any:
    def measure() -> float:
        raise error

    return measure


def section(*more: Row) -> Section:
    rows = (
        Row("a small error", "RK4", lambda: 2e-9, AtMost(1e-8), "Short steps.", place=Place("RK4", 1.0)),
        Row("a larger one", "RK4", lambda: np.float64(2e-5), AtMost(1e-4), "Long steps.", place=Place("RK4", 10.0)),
        Row(
            "too far | beyond",
            "RK4",
            raising(Ended(tx.Result.NON_FINITE, 0.5)),
            Ends(tx.Result.NON_FINITE),
            "Too long steps.",
            slow=True,
            place=Place("RK4", 100.0),
        ),
    )
    return Section("made", "Made up", "For a test.", (*rows, *more), axes=("step", "error"))


SILENT = Row("a silent one", "RK4", lambda: math.nan, AtMost(1.0), "Never.")
ABSENT = Row("needs a package", "none", raising(ImportError("mpmath")), AtMost(1.0), "Not here.")


def outcomes(of: Section) -> list[Outcome]:
    return [Outcome(of, row, row.observe()) for row in of.rows]


def test_the_page_says_what_came_and_why() -> None:
    for made, said in (((), "All 3 rows did what they should. No flight"), ((SILENT,), "**1 of 4 rows did not")):
        blocks = page(outcomes(section(*made)), {}, "a machine", "jax 1", "python -m twistax report --stability")
        for text in (as_markdown(blocks), as_html("title", blocks).replace("<strong>", "**")):
            assert said in text
            assert "Too long steps." in text
            assert "NON_FINITE at t = 0.5 s" in text
    text = as_markdown(page(outcomes(section(SILENT)), {}, "a machine", "jax 1", "again"))
    assert "NOT A NUMBER, AND NOTHING SAID SO" in text
    assert "1 flights ended with a number that is none" in text
    assert "too far \\| beyond" in text


def test_rows_that_need_what_is_not_installed_are_not_run() -> None:
    found = outcomes(section(ABSENT))
    assert [each.verdict for each in found] == ["as expected"] * 3 + ["not run"]
    assert "1 rows were not run" in as_markdown(page(found, {}, "a machine", "jax 1", "again"))


def test_the_figure_shows_numbers_and_ends() -> None:
    text = draw(outcomes(section())).decode()
    assert "Made up" in text
    assert "x: ends by name" in text
    assert draw(outcomes(Section("bare", "Bare", "No places.", (SILENT,)))) is None


def test_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(command, "SECTIONS", (section(),))
    assert main(["report", "--stability", "--out", str(tmp_path)]) == 0
    assert "made            3 rows" in capsys.readouterr().out
    with (tmp_path / "stability.csv").open() as file:
        table = list(csv.DictReader(file))
    assert [row["verdict"] for row in table] == ["as expected"] * 3
    assert (tmp_path / "figures/stability-made.svg").exists()
    assert "data:image/svg+xml" in (tmp_path / "stability.html").read_text()
    assert "figures/stability-made.svg" in (tmp_path / "stability.md").read_text()

    assert main(["report", "--stability", "--quick", "--out", str(tmp_path)]) == 0
    assert "made            2 rows" in capsys.readouterr().out

    monkeypatch.setattr(command, "SECTIONS", (section(SILENT),))
    monkeypatch.setattr(command, "draw", _absent)
    assert main(["report", "--stability", "--out", str(tmp_path)]) == 1
    said = capsys.readouterr().out
    assert "a silent one (RK4): NOT A NUMBER" in said
    assert "get it with pip install 'twistax[plot]'" in said

    (tmp_path / "file").write_text("")
    assert main(["report", "--stability", "--out", str(tmp_path / "file")]) == 2


def _absent(*_: Any) -> bytes:
    raise ImportError("matplotlib")
