"""NASA's rocket of two stages from its DAVE-ML files, where somebody names the folder: TWISTAX_NASA=DIR."""

import os
import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

EXAMPLE = Path(__file__).parents[2] / "examples" / "two_stage_rocket.py"


@pytest.fixture(scope="module")
def folder() -> Path:
    found = Path(os.environ.get("TWISTAX_NASA", "")) / "two_stage_rocket"
    if not found.is_dir():
        pytest.skip("no published files: set TWISTAX_NASA to a folder that has two_stage_rocket")
    return found


@pytest.fixture(scope="module")
def example() -> dict[str, Any]:
    return runpy.run_path(str(EXAMPLE))


@pytest.mark.slow
def test_the_flight_is_that_of_simulation_06(folder: Path, example: dict[str, Any]) -> None:
    off = example["apart"](folder)
    assert off["position"].max() < 150.0
    assert off["attitude"].max() < 1.5e-3
    assert off["rate"].max() < 1e-4


@pytest.mark.slow
def test_stages_burn_out_when_their_fuel_is_gone(folder: Path, example: dict[str, Any]) -> None:
    flown = example["fly"](folder)
    burns = 180_000.0 / (17e6 / (360.0 * 9.8066)), 80_000.0 / (5e6 / (390.0 * 9.8066))
    ends = np.cumsum([burns[0], example["COAST"], burns[1]])
    np.testing.assert_allclose([float(phase.ts[-1]) for phase in flown.phases], [*ends, 200.0], atol=1e-8)
    masses = [float(phase.outputs["mass"][-1]) for phase in flown.phases]
    np.testing.assert_allclose(masses, [134e3, 134e3, 19e3, 19e3], rtol=1e-9)


@pytest.mark.slow
def test_what_the_simulation_says_of_itself(folder: Path) -> None:
    """Its moment in vacuum: half of how fast the inertia shrinks, times the rate relative to the Earth."""
    rows = np.genfromtxt(folder / "Atmos_17_sim_06.csv", delimiter=",", names=True)
    fast = (rows["time"] > 140.0) & (rows["time"] < 195.0)
    spin = rows["bodyAngularRateWrtEi_deg_s_Pitch"]
    moment = rows["aero_bodyMoment_ftlbf_M"][fast] * 1.3558179483314
    per_rate = moment / np.radians(spin[fast] - spin[0])
    half = 0.5 * (941063.762626 - 212384.868421) / 80_000.0 * 5e6 / (390.0 * 9.8066)
    np.testing.assert_allclose(per_rate, half, rtol=2e-4)
