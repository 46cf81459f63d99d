"""Every bad use ends in an error of ours that names the thing, what was expected, what came, and how to mend it."""

from collections.abc import Callable

import pytest
from table import Bad, bad, judge, rows

import twistax as tx


@pytest.mark.parametrize("row", [pytest.param(row, id=f"{area}: {row.name}") for area, row in rows()])
def test_it_is_said(row: Bad, unchecked: None) -> None:
    verdict = judge(row)
    assert verdict.kind == "ours", verdict.text


@pytest.mark.parametrize(
    ("kind", "call", "words"),
    [
        ("silent", lambda: 1.0, ("x",)),
        ("foreign", lambda: 1 / 0, ("x",)),
        ("words", lambda: tx.State(""), ("another",)),
        ("words", lambda: tx.State(""), ()),
        ("words", lambda: tx.State(""), ("State", tx.ShapeError)),
        ("ours", lambda: tx.State(""), ("State", "''")),
    ],
)
def test_what_is_not_said_is_seen(kind: str, call: Callable[[], object], words: tuple[str | type, ...]) -> None:
    assert judge(bad("a use", call, *words)).kind == kind


def test_an_error_after_another_is_seen() -> None:
    def chained() -> None:
        try:
            raise ValueError("inside")
        except ValueError:
            tx.State("")

    assert judge(bad("a use", chained, "State")).kind == "foreign"


def test_no_use_is_there_twice() -> None:
    names = [(area, row.name) for area, row in rows()]
    assert len(set(names)) == len(names) > 300
