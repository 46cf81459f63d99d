"""Steps of explicit methods in C: those of `tx.integrate`, one and many, on groups, in both precisions."""

import ctypes
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from export_systems import STRICT, STRICTER, body, needs_compiler, point

import twistax as tx

LENGTH = 0.02


def compiled(folder: Path, method: Any, dtype: Any = np.float64) -> ctypes.CDLL:
    files = body().to_c(folder, name="body", jacobian=(), steps=method, dtype=dtype, points=[point(1)])
    target = folder / "body.so"
    command = ["gcc", *STRICT, *STRICTER, "-O1", "-shared", "-fPIC", str(files.source), "-lm", "-o", str(target)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return ctypes.CDLL(str(target))


def simulated(library: ctypes.CDLL, steps: int | None, dtype: Any = np.float64) -> dict[str, np.ndarray]:
    """The states after so many steps, or after one by the function of one step."""
    t, x, u, params = point(3)
    real = ctypes.c_double if dtype == np.float64 else ctypes.c_float
    inputs = [np.ascontiguousarray(a, dtype) for values in (x, u, params) for a in values.values()]
    results = {name: np.full(np.shape(value), np.nan, dtype) for name, value in x.items()}
    function = library.body_step if steps is None else library.body_simulate
    counts = [] if steps is None else [ctypes.c_int32(steps)]
    pointers = (
        [ctypes.c_void_p(a.ctypes.data) for a in inputs],
        [ctypes.c_void_p(a.ctypes.data) for a in results.values()],
    )
    function(real(t), *pointers[0], real(LENGTH), *counts, *pointers[1])
    return results


def expected(method: Any, steps: int) -> dict[str, np.ndarray]:
    t, x, u, params = point(3)
    end = t + steps * LENGTH
    flown = tx.integrate(body(), x, t0=t, t1=end, dt=LENGTH, method=method, u=u, params=params)
    return {name: np.asarray(values[-1]) for name, values in flown.xs.items()}


METHODS = {
    "RK4": tx.RKMK(tx.tableaus.RK4),
    "Dormand-Prince": tx.RKMK(tx.tableaus.DORMAND_PRINCE5),
    "ambient": tx.RKMK(tx.tableaus.RK4, tx.charts.Ambient()),
    "commutator-free": tx.CommutatorFree(),
}


@needs_compiler
@pytest.mark.parametrize("name", METHODS)
def test_steps_are_those_of_integrate(name: str, tmp_path: Path) -> None:
    library = compiled(tmp_path, METHODS[name])
    for steps in (None, 1, 25):
        found, reference = simulated(library, steps), expected(METHODS[name], steps or 1)
        for state, values in reference.items():
            np.testing.assert_allclose(found[state], values, rtol=1e-12, atol=1e-12)
    turned = simulated(library, 25)["g"][:3, :3]
    np.testing.assert_allclose(turned.T @ turned, np.eye(3), atol=1e-14)
    start = point(3)[1]
    for state, values in simulated(library, 0).items():
        np.testing.assert_array_equal(values, start[state])


@needs_compiler
def test_steps_in_single_precision(tmp_path: Path) -> None:
    library = compiled(tmp_path, METHODS["RK4"], np.float32)
    for state, values in expected(METHODS["RK4"], 25).items():
        np.testing.assert_allclose(simulated(library, 25, np.float32)[state], values, rtol=2e-5, atol=2e-5)


@needs_compiler
def test_steps_allocate_nothing_and_agree_with_the_test_main(tmp_path: Path) -> None:
    files = body().to_c(tmp_path, name="body", steps=METHODS["RK4"], points=[point(1), point(2)])
    header = files.header.read_text()
    assert "void body_step(" in header
    assert "void body_simulate(" in header
    assert "length of the step, h" in header
    target = tmp_path / "test"
    command = [
        "gcc",
        *STRICT,
        "-fsanitize=undefined",
        "-fno-sanitize-recover",
        "-O1",
        str(files.source),
        str(files.test),
    ]
    subprocess.run([*command, "-lm", "-o", str(target)], check=True)
    ran = subprocess.run([str(target)], capture_output=True, text=True)
    assert ran.returncode == 0, ran.stdout
    assert "step next_g, point 2" in ran.stdout
    if shutil.which("nm"):
        made = tmp_path / "body.o"
        subprocess.run(["gcc", *STRICT, "-O1", "-c", str(files.source), "-o", str(made)], check=True)
        undefined = subprocess.run(["nm", "-u", str(made)], capture_output=True, text=True, check=True).stdout
        assert "alloc" not in undefined


@needs_compiler
def test_time_goes_on_from_step_to_step(tmp_path: Path) -> None:
    p, u, rk4 = tx.State("p"), tx.Control("u"), METHODS["RK4"]
    dynamics = tx.compile(tx.System(rates={p: u * tx.Sin(9.0 * tx.Time()) - p}))
    files = dynamics.to_c(tmp_path, name="forced", jacobian=(), steps=rk4)
    target = tmp_path / "forced.so"
    command = ["gcc", *STRICT, "-O1", "-shared", "-fPIC", str(files.source), "-lm", "-o", str(target)]
    subprocess.run(command, check=True)
    inputs, result = [np.array([0.3]), np.array([2.0])], np.zeros(1)
    before = [ctypes.c_void_p(a.ctypes.data) for a in inputs]
    simulate, after = ctypes.CDLL(str(target)).forced_simulate, ctypes.c_void_p(result.ctypes.data)
    simulate(ctypes.c_double(1.0), *before, ctypes.c_double(0.05), ctypes.c_int32(20), after)
    flown = tx.integrate(dynamics, {"p": 0.3}, t0=1.0, t1=2.0, dt=0.05, method=rk4, u={"u": 2.0})
    np.testing.assert_allclose(result, flown.xs["p"][-1], rtol=1e-12)


def test_what_is_no_explicit_method_is_refused(tmp_path: Path) -> None:
    with pytest.raises(tx.ModelError, match="explicit method"):
        body().to_c(tmp_path, steps=tx.ImplicitRKMK(tx.tableaus.RADAU_IIA5))
    with pytest.raises(tx.ModelError, match=r"expects a method such as tx\.RKMK"):
        body().to_c(tmp_path, steps="RK4")
