"""The command from end to end: a landing with few nodes, and a start from which there is none."""

import csv
import sys
from pathlib import Path

import pytest

from twistax.__main__ import main
from twistax.demo import landing
from twistax.demo.derivatives import DerivativeCheck


def test_a_landing_from_start_to_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    start = "height=500,offset=100:40,velocity=-20:-5:-70,tilt=20"
    status = main(["demo", "--initial", start, "--nodes", "12", "--out", str(tmp_path / "new" / "out")])
    said = capsys.readouterr().out
    assert status == 0, said
    for words in ("they agree", "compiled in", "RKMK4", "Dopri8", "SOLVED", "gimbal", "landed    after"):
        assert words in said
    assert "NOT" not in said
    with (tmp_path / "new" / "out" / "landing.csv").open() as file:
        last = list(csv.DictReader(file))[-1]
    assert abs(float(last["height (m)"])) < 0.5
    assert float(last["mass (kg)"]) > 27_000.0
    assert (tmp_path / "new" / "out" / "landing.png").stat().st_size > 20_000


@pytest.mark.slow
def test_a_start_without_a_landing_is_said_and_saved(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(landing, "check_derivatives", lambda *_, **__: DerivativeCheck(1, 0.0, 0.0))
    # As if it were not installed.
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    start = "height=40,velocity=0:0:-150"
    status = main(["demo", "--initial", start, "--nodes", "6", "--max-iterations", "30", "--out", str(tmp_path)])
    said = capsys.readouterr().out
    assert status == 1, said
    assert "No landing was found from this start; the best try was saved." in said
    assert "off the pad" in said.split("It violates:")[1]
    assert "pip install 'twistax[plot]'" in said
    # The animation is written where viser is installed.
    assert {path.name for path in tmp_path.iterdir()} - {"best_try.html"} == {"best_try.csv"}
