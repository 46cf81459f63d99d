"""The table of identities holds, and can fail."""

from __future__ import annotations

import dataclasses

import pytest

import twistax as tx
from twistax.report import identities as report


@pytest.fixture(scope="module")
def rows() -> list[report.Row]:
    return report.identities(cases=20)


def test_every_identity_holds_in_both_orders(rows: list[report.Row]) -> None:
    assert [row for row in rows if not row.holds] == []
    assert len({row.identity for row in rows}) == len(rows) / 2
    for order in (tx.LINEAR_FIRST, tx.ANGULAR_FIRST):
        assert len([row for row in rows if row.order == order]) == len(rows) / 2


def test_a_wrong_formula_stands_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each pair of operators that sources confuse, put in each other's place."""
    confused = {
        "Ad_T eta": lambda o: tx.lie.SE3AdjointDual(report._T, order=o) @ report._eta,
        "Ad*_T F": lambda o: tx.lie.SE3Adjoint(report._T, order=o) @ report._F,
        "J_r^-1": lambda o: tx.lie.LeftJacobianInverse(report._xi, order=o),
        "<ad*": lambda o: tx.linalg.Dot(tx.lie.AdjointDual(report._xi, report._F, order=o), report._eta),
    }
    wrong = tuple(
        dataclasses.replace(identity, expression=expression)
        for identity in report._IDENTITIES
        for start, expression in confused.items()
        if identity.name.startswith(start)
    )
    assert len(wrong) == len(confused)
    monkeypatch.setattr(report, "_IDENTITIES", wrong)
    assert all(row.worst > 0.1 for row in report.identities(cases=3))


def test_the_command_prints_a_table(
    rows: list[report.Row], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(report, "identities", lambda: rows)
    assert report.main() == 0
    assert "LINEAR_FIRST" in capsys.readouterr().out
    monkeypatch.setattr(report, "identities", lambda: [dataclasses.replace(rows[0], worst=1e-3)])
    assert report.main() == 1
    assert "ABOVE THE BAR" in capsys.readouterr().out
