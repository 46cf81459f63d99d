"""The table of joints and bodies holds, and can fail."""

from __future__ import annotations

import dataclasses

import pytest

import twistax as tx
from twistax.mechanics import SpatialInertia
from twistax.mechanics.joints import screws
from twistax.report import mechanics as report


@pytest.fixture(scope="module")
def rows() -> list[report.Row]:
    return report.mechanics(cases=20)


def test_every_statement_holds(rows: list[report.Row]) -> None:
    assert [row for row in rows if not row.holds] == []
    assert len(rows) == 17


def test_wrenches_moved_as_twists_stand_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(screws, "SE3AdjointDual", tx.lie.SE3Adjoint)
    monkeypatch.setattr(report, "_JOINTS", report._JOINTS[:1])
    worst = {row.statement: row.worst for row in report.mechanics(cases=3)}
    for statement in ("h*^T H = I", "reciprocity: H^T H-bar* = 0", "power of an actuator = tau . q'"):
        assert worst[statement] > 0.1


def test_a_body_about_the_wrong_point_stands_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """The tensor read as one about the origin of the frame."""
    monkeypatch.setattr(report, "_JOINTS", ())
    monkeypatch.setattr(report, "SpatialInertia", SpatialInertia.about_origin)
    assert all(row.worst > 1e-3 for row in report.mechanics(cases=3) if row.statement in ("M", "momentum"))


def test_the_command_prints_a_table(
    rows: list[report.Row], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(report, "mechanics", lambda: rows)
    assert report.main() == 0
    assert "reciprocity" in capsys.readouterr().out
    monkeypatch.setattr(report, "mechanics", lambda: [dataclasses.replace(rows[0], worst=1e-3)])
    assert report.main() == 1
    assert "ABOVE THE BAR" in capsys.readouterr().out
