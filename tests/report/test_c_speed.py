"""The comparison with C flies the same body in both, and says so where there is no compiler."""

from pathlib import Path

import pytest

from twistax.report import c_speed


@pytest.mark.skipif(c_speed.gcc() is None, reason="needs gcc")
def test_both_fly_the_same() -> None:
    ours, *in_c = c_speed.compare(c_speed.gcc() or "", 2_000, rounds=1)
    assert [row.name for row in in_c] == ["C -O3 -march=native", "C -O3 -march=native -fno-tree-vectorize"]
    assert ours.step > 0.0
    for row in in_c:
        assert row.difference < 1e-12
        assert row.step > 0.0


@pytest.mark.skipif(c_speed.gcc() is None, reason="needs gcc")
def test_the_difference_sees_another_body(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """With another drag the ends are far more than the bar apart."""
    changed = tmp_path / "rkmk4.c"
    changed.write_text(c_speed.SOURCE.read_text().replace("DRAG = 0.1;", "DRAG = 0.1001;"))
    monkeypatch.setattr(c_speed, "SOURCE", changed)
    assert c_speed.compare(c_speed.gcc() or "", 2_000, rounds=1)[1].difference > c_speed.AGREEMENT


def test_without_gcc_it_says_so(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(c_speed, "gcc", lambda: None)
    assert c_speed.main() == 0
    assert "absent, because there is no gcc on this machine" in capsys.readouterr().out
