"""The figures of native kernels: what they compare, and that they see a difference."""

import numpy as np
import pytest

import twistax as tx
from twistax.report import kernels

needs_llvmlite = pytest.mark.skipif(not kernels.installed(), reason="native kernels need llvmlite")


@needs_llvmlite
def test_flights_in_a_kernel_end_where_those_by_xla_do() -> None:
    ratio, apart = kernels.flights(20, 10, rounds=1)
    assert ratio > 0.0
    assert 0.0 <= apart < 1e-13


@needs_llvmlite
def test_a_kernel_is_built_for_the_derivatives_too() -> None:
    programs = kernels.programs()
    assert [program.operations > 1_000 for program in programs.values()] == [True, True]
    assert kernels.build_seconds(programs["the Panda's ABA"]) > 0.0


@needs_llvmlite
def test_sine_and_cosine_are_judged_by_the_last_place(monkeypatch: pytest.MonkeyPatch) -> None:
    x = kernels.angles(100)
    assert 0.3 < kernels.units_off(x, tx.Native()) < 2.0
    monkeypatch.setattr(kernels, "Sin", lambda s: tx.Sin(s * (1.0 + 1e-14)))
    assert kernels.units_off(x, tx.XLA()) > 2.0
    monkeypatch.setattr(kernels, "Sin", lambda s: tx.Sin(s + tx.Where(s <= 1.0, 0.0, np.nan)))
    assert np.isnan(kernels.units_off(x, tx.XLA()))


def test_without_llvmlite_it_says_so(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(kernels, "installed", lambda: False)
    assert kernels.main() == 0
    assert "absent, because llvmlite is not installed" in capsys.readouterr().out
