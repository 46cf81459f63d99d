"""The F-16 of NASA/TM-2015-218675 from its DAVE-ML files, where somebody names the folder: TWISTAX_NASA=DIR."""

import os
import runpy
import shutil
import subprocess
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

import twistax as tx

EXAMPLES = Path(__file__).parents[2] / "examples"
#: At t = 0 of simulation 05, deg, by case.
PITCH = {"11": 2.6389261150480663, "12": -0.7415762204654732, "15": 2.687221169199962}
#: How far simulation 05 may be, m: in the standard atmosphere, in its air, and there with commands 5 ms earlier.
BARS = {
    "11": (1.5e-3, 1.5e-3, None),
    "12": (1e-3, 1e-3, None),
    "13.1": (4e-2, 4e-2, 1.5e-2),
    "13.2": (2e-2, 2e-2, 2e-4),
    "15": (2e-2, 3e-3, None),
}


@pytest.fixture(scope="module")
def folder() -> Path:
    found = Path(os.environ.get("TWISTAX_NASA", ""))
    if not (found / "f16").is_dir():
        pytest.skip("no published files: set TWISTAX_NASA to a folder that has f16 and 11_f16_trimmed_subsonic")
    return found


@pytest.fixture(scope="module")
def example() -> dict[str, Any]:
    return runpy.run_path(str(EXAMPLES / "f16.py"))


@pytest.mark.slow
@pytest.mark.parametrize("number", PITCH)
def test_trimmed_as_simulation_05(number: str, folder: Path, example: dict[str, Any]) -> None:
    for air, tolerance in (("standard", 2e-5), ("05", 1e-7)):
        dynamics, level = example["trimmed"](folder / "f16", number, example["PLANETS"][air])
        attitude = np.asarray(dynamics.outputs(0.0, level.x, level.u, level.params)["attitude"])
        assert level.saturated == {}
        assert np.degrees(np.arcsin(-attitude[2, 0])) == pytest.approx(PITCH[number], abs=tolerance)


@pytest.mark.slow
@pytest.mark.parametrize("number", BARS)
def test_flown_as_simulation_05(number: str, folder: Path, example: dict[str, Any]) -> None:
    for air, early, bar in zip(("standard", "05", "05"), (0.0, 0.0, 0.005), BARS[number], strict=True):
        if bar is not None:
            assert example["apart"](folder, "05", number, example["PLANETS"][air], early=early).max() < bar


@pytest.mark.slow
def test_what_is_left_of_case_11_is_a_stick_that_is_not_quite_trimmed(folder: Path, example: dict[str, Any]) -> None:
    dynamics, level = example["trimmed"](folder / "f16", "11", example["PLANETS"]["05"])
    rows = np.genfromtxt(folder / example["CASES"]["11"].folder / "sim_05.csv", delimiter=",", names=True)
    theirs = np.stack([rows[f"eiPosition_ft_{axis}"] for axis in "XYZ"], axis=1) * 0.3048
    params = {**level.params, "stick": level.params["stick"] - 1e-8}
    times = np.round(rows["time"], 1)
    flown = tx.integrate(dynamics, level.x, t1=180.0, dt=0.005, u=level.u, params=params, save_at=times)
    assert np.linalg.norm(np.asarray(flown.xs["g"])[:, :3, 3] - theirs, axis=1).max() < 3e-4


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "reached"),
    [("13.3", {"euler": np.radians(60.0)}), ("13.4", {"off_course": 2000.0 * 0.3048}), ("16", {})],
)
def test_flights_without_a_published_one_do_as_they_are_told(
    number: str, reached: dict[str, float], folder: Path, example: dict[str, Any]
) -> None:
    flown = example["fly"](folder / "f16", number)
    if "euler" in reached:
        assert float(flown.outputs["euler"][-1][2]) == pytest.approx(reached["euler"], abs=2e-3)
    elif reached:
        assert float(flown.xs["off_course"][-1]) == pytest.approx(reached["off_course"], abs=10.0)
        assert not np.asarray(flown.xs["off_course"])[:201].any()  # the deviation counts from the command on
    else:  # round the equator at the date line, three nautical miles off
        north = np.asarray(flown.outputs["latitude"])
        east = np.mod(np.asarray(flown.outputs["longitude"]), 2.0 * np.pi) - np.pi
        radius = np.degrees(np.hypot(north, east))[600:] * 60.0
        assert np.abs(radius - 3.0).max() < 0.1
    assert np.ptp(np.asarray(flown.outputs["altitude"])[-50:]) < 1.0


@pytest.mark.slow
def test_flown_by_a_c_program(folder: Path, example: dict[str, Any], tmp_path: Path) -> None:
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler")
    dynamics, level = example["trimmed"](folder / "f16")
    files = dynamics.to_c(tmp_path, name="f16", points=[(0.0, level.x, level.u, level.params)])
    program = tmp_path / "f16_flight"
    warnings = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-O1", f"-I{tmp_path}"]
    sources = [str(EXAMPLES / "f16_flight.c"), str(files.source)]
    subprocess.run([compiler, *warnings, *sources, "-lm", "-o", str(program)], check=True)
    given = [18_000, 0.01, *np.ravel(level.x["g"]), *level.x["V"], level.params["throttle"], level.params["stick"]]
    text = " ".join(repr(float(value)) if i else str(value) for i, value in enumerate(given))
    lines = subprocess.run([program], input=text, capture_output=True, text=True, check=True).stdout.splitlines()
    flown = np.array([line.split() for line in lines[:-1]], float)

    rows = np.genfromtxt(folder / example["CASES"]["11"].folder / "sim_05.csv", delimiter=",", names=True)[10::10]
    theirs = np.stack([rows[f"eiPosition_ft_{axis}"] for axis in "XYZ"], axis=1) * 0.3048
    assert np.linalg.norm(flown - theirs, axis=1).max() < 1.5e-3
    end: tx.Solution = example["fly"](folder / "f16", "11", times=np.array([0.0, 180.0]), dt=0.01)
    assert np.linalg.norm(flown[-1] - np.asarray(end.xs["g"])[-1, :3, 3]) < 1e-5
    x = jax.tree.map(lambda leaf: leaf[-1], end.xs)
    by_x = dynamics.jacobian(180.0, x, dict.fromkeys(level.u, 0.0), level.params, wrt="x")["x"]
    assert float(lines[-1]) == pytest.approx(float(np.linalg.norm(by_x)), rel=1e-6)
