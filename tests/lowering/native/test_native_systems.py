"""Compiled systems with kernels: what they give, what they say, and what happens where there is none."""

from __future__ import annotations

import functools
import importlib.util
import os
import re
import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

pytest.importorskip("llvmlite", reason="native kernels need llvmlite")

import twistax as tx
from twistax import progress

w, mass, R = tx.State("w", (3,)), tx.State("mass"), tx.State("R", group=tx.SO3)
J, F = tx.Parameter("J", value=np.diag([1.0, 2.0, 3.0])), tx.Control("F", (3,))
BODY = tx.System(
    rates={w: tx.linalg.Solve(J, F - tx.linalg.Cross(w, J @ w)), R: w, mass: -tx.linalg.Norm(F)},
    outputs={"energy": 0.5 * tx.linalg.Dot(w, J @ w)},
    controls=[F],
    parameters=[J],
)
NATIVE, ARRAYS = tx.compile(BODY, backend=tx.Native(least=0)), tx.compile(BODY, backend=tx.JAX())
START = {"w": np.array([0.4, -0.5, 0.6]), "R": np.eye(3), "mass": np.float64(4.0)}
U = {"F": np.array([0.1, -0.2, 0.3])}
s = tx.State("s", (3,))
SMALL = tx.System(rates={s: tx.Sin(s) * s}, outputs={"length": tx.linalg.Norm(s)})
AT = {"s": np.array([0.4, -0.5, 0.6])}
RATES, SLOPES = np.sin(AT["s"]) * AT["s"], np.diag(np.sin(AT["s"]) + np.cos(AT["s"]) * AT["s"])
KERNEL = tx.compile(SMALL, backend=tx.Native(least=0))
WS = np.random.default_rng(0).normal(size=(11, 3))


@pytest.fixture(autouse=True)
def first_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """No message was given yet."""
    monkeypatch.setattr(progress, "_SAID", set())


def _near(own: Any, other: Any) -> None:
    assert jax.tree.structure(own) == jax.tree.structure(other)
    for a, b in zip(jax.tree.leaves(own), jax.tree.leaves(other), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-13)


def test_as_in_arrays() -> None:
    """Rates, outputs, Jacobian; batched with parameters that are the same for all."""

    def every(dynamics: tx.Dynamics) -> Any:
        def one(own: Any) -> Any:
            x = {**START, "w": own}
            return dynamics(0.0, x, U), dynamics.outputs(0.0, x, U), dynamics.jacobian(0.0, x, U)

        return one(START["w"]), jax.vmap(one)(WS)

    own, other = every(NATIVE), jax.jit(lambda: every(ARRAYS))()
    _near(own, other)
    lowered = jax.jit(jax.vmap(lambda own: NATIVE.jacobian(0.0, {**START, "w": own}, U))).lower(WS).as_text()
    assert "custom_call" in lowered
    assert "twistax_" in lowered


def test_loops_keep_what_xla_makes() -> None:
    """A kernel cannot be part of the small functions that loops are compiled as."""
    flights = [tx.integrate(d, START, t1=0.5, method=tx.RKMK(tx.tableaus.RK4), steps=5, u=U) for d in (NATIVE, ARRAYS)]
    _near(flights[0].xs, flights[1].xs)
    inputs = NATIVE.functions.prepare(0.0, START, U)
    loop = jax.jit(NATIVE.functions.vector_field).lower(inputs.t, inputs.x, inputs.u, inputs.params).as_text()
    assert "twistax_" not in loop


def test_explained() -> None:
    assert tx.compile(SMALL, backend=tx.Native(least=0)).explain().backend.startswith("native: ")
    r = tx.State("r", (9,))
    solved = tx.System(rates={r: tx.linalg.Solve(tx.Parameter("A", value=5.0 * np.eye(9)) + tx.linalg.Diag(r), r)})
    explained = tx.compile(solved, backend=tx.Native(least=0)).explain().backend
    assert "not native: " in explained
    assert "has no native form" in explained


def test_without_llvmlite(monkeypatch: pytest.MonkeyPatch) -> None:
    """XLA instead, and one message that names the package."""
    found = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *a: None if name == "llvmlite" else found(name, *a))
    dynamics = tx.compile(SMALL, backend=tx.Native(least=0))
    with pytest.warns(RuntimeWarning, match="pip install llvmlite") as messages:
        rates = dynamics(0.0, AT)
    assert len(messages) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        dynamics.outputs(0.0, AT)
        slopes = dynamics.jacobian(0.0, AT)["x"]
    np.testing.assert_allclose(rates["s"], RATES, rtol=1e-14)
    np.testing.assert_allclose(slopes, SLOPES, rtol=1e-14)
    assert "llvmlite is not installed" in dynamics.explain().backend


def test_a_nearly_singular_matrix_has_a_kernel() -> None:
    """Of condition 1e10, known beforehand: what rounding makes of it is no reason to refuse the kernel."""
    A = np.array(
        [
            [0.16290143712055785, -0.07504039639663738, -0.1747189177016903],
            [-0.45697207630011893, 0.21049107516605906, 0.4900973967054117],
            [0.4335300098000213, -0.19967985897076468, -0.46492968909557275],
        ]
    )
    clock = tx.State("clock")  # with it a row of random numbers is drawn that rounds to the same, moved or not
    own = tx.System(rates={clock: 1.0, s: 0.0 * s}, outputs={"y": tx.linalg.Solve(A, A @ s)})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = tx.compile(own, backend=tx.Native(least=0)).outputs(0.0, AT | {"clock": 0.0})["y"]
    np.testing.assert_allclose(found, AT["s"], atol=1e-5)


def test_too_large_written_out() -> None:
    """A solve is a call for XLA; written out for a kernel it takes more scalars than there may be."""
    r = tx.State("r", (6,))
    system = tx.System(rates={r: tx.linalg.Solve(tx.Parameter("A", value=5.0 * np.eye(6)) + tx.linalg.Diag(r), r)})
    dynamics = tx.compile(system, backend=tx.Native(scalars=tx.XLA(largest=300), least=0))
    np.testing.assert_allclose(dynamics(0.0, {"r": np.ones(6)})["r"], 1.0 / 6.0, rtol=1e-13)
    assert "not native: the function takes more than 300 scalars" in dynamics.explain().backend


def test_least() -> None:
    """Small calls stay XLA's, batches of the same function are native."""
    dynamics = tx.compile(BODY, backend=tx.Native(least=500))
    one = jax.jit(lambda own: dynamics(0.0, {**START, "w": own}, U))
    assert "twistax_" not in one.lower(WS[0]).as_text()
    assert "twistax_" in jax.jit(jax.vmap(one)).lower(np.zeros((64, 3))).as_text()


@pytest.mark.parametrize("options", [{"threads": 0}, {"least": -1}])
def test_options_that_are_none(options: dict[str, int]) -> None:
    with pytest.raises(tx.ModelError, match=next(iter(options))):
        tx.Native(**options)


def test_the_same_system_by_another_backend() -> None:
    """Calls too, not only what loops call."""
    native, other = (
        jax.jit(d).lower(0.0, AT).as_text() for d in (KERNEL, tx.Dynamics(KERNEL.functions.run_by(tx.JAX())))
    )
    assert "twistax_" in native
    assert "twistax_" not in other


def test_backends_are_values() -> None:
    assert tx.Native() == tx.Native()
    assert hash(tx.Native(threads=2)) == hash(tx.Native(threads=2))
    assert tx.Native(threads=2) != tx.Native()


# ---- the function that XLA calls -------------------------------------------------------------------------------------


# ---- other processes -------------------------------------------------------------------------------------------------

_PROCESS = """
import sys
import jax
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_compilation_cache_dir", sys.argv[1])
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
found = []
jax.monitoring.register_event_listener(lambda event, **_: found.append(event))
import numpy as np, twistax as tx
from twistax.scalar.targets.llvm import kernel
compiled, texts = kernel.compiled, []
kernel.compiled = lambda text, *a: texts.append(text) or compiled(text, *a)
x = tx.State("x", (4,))
dynamics = tx.compile(tx.System(rates={x: tx.Sin(x) * x}), backend=tx.Native(least=0))
value = jax.jit(jax.vmap(lambda v: dynamics(0.0, {"x": v})["x"]))
rows = np.arange(20.0).reshape(5, 4)
np.testing.assert_allclose(value(rows), np.sin(rows) * rows, rtol=1e-13)
print("hits", sum(event.endswith("/cache_hits") for event in found), len(texts))
"""


def test_processes_share_a_cache(tmp_path: Path) -> None:
    """The second loads what the first compiled: the program of XLA, and the kernel that it calls."""
    environment = {**os.environ, "JAX_PLATFORMS": "cpu", "TWISTAX_CACHE": str(tmp_path / "kernels")}
    counts = []
    for _ in range(2):
        ran = subprocess.run(
            [sys.executable, "-c", _PROCESS, str(tmp_path)],
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        assert ran.returncode == 0, ran.stderr
        counts.append([int(count) for count in ran.stdout.split()[-2:]])
    assert counts[0] == [0, 2]
    assert counts[1][0] >= 1
    assert counts[1][1] == 0


def test_export() -> None:
    """A program that was exported runs where the same system was compiled, if its call is allowed by name."""
    function = jax.jit(jax.vmap(lambda own: NATIVE(0.0, {**START, "w": own}, U)["w"]))
    (target,) = set(re.findall(r"twistax_\w+", function.lower(WS).as_text()))
    allowed = [jax.export.DisabledSafetyCheck.custom_call(target)]
    exported = jax.export.export(function, disabled_checks=allowed)(WS)
    if importlib.util.find_spec("flatbuffers"):
        exported = jax.export.deserialize(exported.serialize())
    _near(exported.call(WS), function(WS))
    with pytest.raises(ValueError, match="custom call"):
        jax.export.export(function)(WS)


def test_no_warning_by_default() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tx.compile(BODY)(0.0, START, U)


def test_the_default(monkeypatch: pytest.MonkeyPatch) -> None:
    """Large functions are native where llvmlite is; small ones, and all without it, are as ever: without a warning."""
    large = tx.System(rates={s: functools.reduce(lambda x, k: tx.Sin(x) * s + k, range(60), s)})
    assert tx.compile(large).backend == tx.compile(large, backend="auto").backend
    assert "twistax_" in jax.jit(tx.compile(large)).lower(0.0, AT).as_text()
    assert "twistax_" not in jax.jit(tx.compile(SMALL)).lower(0.0, AT).as_text()
    found = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *a: None if name == "llvmlite" else found(name, *a))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        without = tx.compile(large)
        assert "twistax_" not in jax.jit(without).lower(0.0, AT).as_text()
        without.jacobian(0.0, AT)
    assert repr(without).endswith("backend: auto = XLA)")


def test_other_devices_run_what_xla_makes() -> None:
    """A kernel is for the CPU; a program for several kinds of device holds both."""
    dynamics = tx.compile(SMALL, backend=tx.Native(least=0))
    traced = jax.jit(jax.vmap(lambda own: dynamics(0.0, {"s": own}))).trace(WS)
    assert "twistax_" in traced.lower(lowering_platforms=("cpu",)).as_text()
    assert "twistax_" not in traced.lower(lowering_platforms=("cuda",)).as_text()
    both = traced.lower(lowering_platforms=("cpu", "cuda")).as_text()
    assert "twistax_" in both
    assert "stablehlo.sine" in both
