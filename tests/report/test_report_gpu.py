"""`python -m twistax report --gpu` on a machine without a CUDA device."""

from __future__ import annotations

from pathlib import Path

import jax
import pytest

from twistax.jax_inside import backends
from twistax.report.gpu.command import measure
from twistax.report.gpu.sections import SECTIONS


@pytest.mark.skipif("cuda" in backends(), reason="there is a CUDA device")
def test_what_needs_a_device_is_not_measured(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    x64 = jax.config.jax_enable_x64
    for name in SECTIONS:
        measure(str(tmp_path), name)
    jax.config.update("jax_enable_x64", x64)
    assert capsys.readouterr().out.splitlines() == ["  not measured: JAX has no CUDA device here"] * len(SECTIONS)
    assert not list(tmp_path.iterdir())
