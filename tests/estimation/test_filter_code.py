"""Filters in C: their test program, and the compiled functions against `predict` and `update`."""

import ctypes
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

import twistax as tx
from twistax.estimation import ErrorStateKalman, Invariance, InvariantKalman, SquareRootKalman, Trapezoidal

q, b = tx.State("q", group=tx.SO3), tx.State("b", shape=(3,))
gyro = tx.Control("gyro", shape=(3,))
noise = tx.Noise("n", shape=(3,), density=tx.Parameter("density", value=0.1))
walk = tx.Noise("walk", shape=(3,), density=np.array([0.01, 0.02, 0.03]))
SATELLITE = tx.compile(tx.System(rates={q: gyro - b - noise, b: walk - 0.1 * b}))
FIELD = np.array([0.3, -0.2, 0.9])
MEASUREMENTS = [tx.Measurement("a field", q.T @ FIELD, covariance=0.01), tx.Measurement("star", q, covariance=1e-4)]
START = {
    "q": expm(np.array([[0.0, 0.8, 0.2], [-0.8, 0.0, -0.5], [-0.2, 0.5, 0.0]])),
    "b": np.array([0.01, -0.02, 0.03]),
}
RATE = np.array([0.4, -0.7, 1.1])
ROOT = np.random.default_rng(0).normal(size=(6, 6))
P0 = 0.1 * ROOT @ ROOT.T
STRICT = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O1"]
needs_compiler = pytest.mark.skipif(shutil.which("gcc") is None, reason="needs a C compiler")


def run(*command: Any) -> str:
    return subprocess.run([str(part) for part in command], capture_output=True, text=True, check=True).stdout


def library(files: Any, folder: Path) -> ctypes.CDLL:
    run("gcc", *STRICT, "-shared", "-fPIC", files.source, "-lm", "-o", folder / "kalman.so")
    return ctypes.CDLL(str(folder / "kalman.so"))


def called(function: Any, last: Any, sizes: list[tuple[int, ...]]) -> list[np.ndarray]:
    """The results of a function of the library; its last argument is a number or an array."""
    arrays = [np.ascontiguousarray(a) for a in (START["q"], START["b"], RATE, np.array(0.1), np.tril(P0))]
    results = [np.full(size, np.nan) for size in sizes]
    pointers = [ctypes.c_void_p(a.ctypes.data) for a in arrays]
    value = ctypes.c_double(last) if isinstance(last, float) else ctypes.c_void_p(last.ctypes.data)
    function(ctypes.c_double(0.0), *pointers, value, *(ctypes.c_void_p(a.ctypes.data) for a in results))
    return results


@needs_compiler
@pytest.mark.parametrize("options", [{}, {"invariance": Invariance.RIGHT, "gate": 0.99, "noise": Trapezoidal()}])
def test_the_functions_are_predict_and_update(options: dict[str, Any], tmp_path: Path) -> None:
    """The prediction by `VanLoan()` has a loop."""
    kind = InvariantKalman if options else ErrorStateKalman
    kalman = kind(SATELLITE, MEASUREMENTS, **options)
    files = kalman.to_c(tmp_path)
    run("gcc", *STRICT, files.source, files.test, "-lm", "-o", tmp_path / "test")
    assert "all agree" in run(tmp_path / "test")

    compiled, states = library(files, tmp_path), [(3, 3), (3,), (6, 6)]
    prediction = kalman.predict(0.0, START, P0, 0.2, {"gyro": RATE})
    expected = prediction.x["q"], prediction.x["b"], prediction.P
    assert ("for (;;)" in files.source.read_text()) is not bool(options)
    for one, other in zip(called(compiled.kalman_predict, 0.2, states), expected):
        np.testing.assert_allclose(one, other, atol=1e-14)
    for h in (1e-3, 50.0):  # of no doublings, and of many
        prediction = kalman.predict(0.0, START, P0, h, {"gyro": RATE})
        np.testing.assert_allclose(called(compiled.kalman_predict, h, states)[2], prediction.P, rtol=1e-12, atol=1e-12)
    near, far = FIELD @ START["q"] + 0.05, 5.0 * FIELD
    for z in (near, far):
        update = kalman.update("a field", 0.0, START, P0, z, {"gyro": RATE})
        assert bool(update.used) is (z is near or not options)
        results = called(compiled.kalman_update_a_field, z, [*states, ()])
        for one, other in zip(results, (update.x["q"], update.x["b"], update.P, update.nis)):
            np.testing.assert_allclose(one, other, atol=1e-13)
    star = np.ascontiguousarray(START["q"] @ expm(np.array([[0.0, -0.1, 0.0], [0.1, 0.0, 0.0], [0.0, 0.0, 0.0]])))
    update = kalman.update("star", 0.0, START, P0, star, {"gyro": RATE})
    results = called(compiled.kalman_update_star, star, [*states, ()])
    np.testing.assert_allclose(results[2], update.P, atol=1e-13)


def test_the_trapezoidal_rule_tends_to_the_integral() -> None:
    """Of a third of the step, a ninth of the difference over the same time; both in the tangent space at its end."""
    kalman, exact = (ErrorStateKalman(SATELLITE, [], noise=how) for how in (Trapezoidal(), None))
    errors = []
    for count in (1, 3):
        (x, P), (y, N) = [(START, np.zeros((6, 6)))] * 2
        for _ in range(count):
            (x, P, _), (y, N, _) = (
                one.predict(0.0, state, cov, 0.3 / count, {"gyro": RATE})
                for one, state, cov in ((kalman, x, P), (exact, y, N))
            )
        errors.append(np.abs(np.asarray(P - N)).max())
    assert 8.0 < errors[0] / errors[1] < 10.0


@pytest.mark.parametrize(
    ("kalman", "message"),
    [
        (lambda: SquareRootKalman(SATELLITE, []), "QR"),
        (
            lambda: ErrorStateKalman(
                SATELLITE,
                [tx.Measurement(name, q.T @ FIELD, covariance=1.0) for name in ("a b", "a_b")],
                noise=Trapezoidal(),
            ),
            "would have the name update_a_b in C",
        ),
    ],
)
def test_what_c_cannot_have_is_refused(kalman: Any, message: str, tmp_path: Path) -> None:
    with pytest.raises(tx.ModelError, match=message):
        kalman().to_c(tmp_path)


@pytest.mark.usefixtures("unchecked")
def test_noise_is_one_of_two() -> None:
    with pytest.raises(tx.ModelError, match="noise expects"):
        ErrorStateKalman(SATELLITE, [], noise="trapezoidal")  # type: ignore[arg-type]
