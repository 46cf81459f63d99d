"""The F-16 of NASA/TM-2015-218675 from its DAVE-ML files, where somebody names the folder: TWISTAX_NASA=DIR."""

from __future__ import annotations

import os
import runpy
from pathlib import Path

import numpy as np
import pytest

EXAMPLE = Path(__file__).parents[2] / "examples" / "f16.py"
#: At t = 0 of simulation 05, deg.
PITCH = 2.6389261150480663


@pytest.mark.slow
def test_case_11_trimmed_and_flown() -> None:
    folder = Path(os.environ.get("TWISTAX_NASA", ""))
    if not (folder / "f16").is_dir():
        pytest.skip("no published files: set TWISTAX_NASA to a folder that has f16 and 11_f16_trimmed_subsonic")
    example = runpy.run_path(str(EXAMPLE))
    dynamics, level = example["trimmed"](folder / "f16")
    attitude = np.asarray(dynamics.outputs(0.0, level.x, None, level.params)["attitude"])
    assert level.saturated == {}
    assert np.degrees(np.arcsin(-attitude[2, 0])) == pytest.approx(PITCH, abs=2e-5)
    assert example["apart"](folder, "05").max() < 1e-3
