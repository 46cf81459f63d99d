"""Controllers of problems with several phases, and with continuous controls: feedback, gains, data and C code."""

import ctypes
import functools
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_controller import full, regulator
from trajectory_systems import HEUN, spinning_ball

import twistax as tx
from twistax.errors import TrajectoryError
from twistax.trajectory import Controller, Linear, Phase, Problem, Spline, Status

LINEAR = Linear()


@functools.cache
def two_burns() -> Problem:
    """A rocket climbs to rest at 3 in the least time, and drops a quarter of its mass when the first tank is empty."""
    p, v, m, F = tx.State("p"), tx.State("v"), tx.State("m", guess=1.5), tx.Control("F", min=0.0, max=3.0)
    target = tx.Parameter("target", value=3.0)
    dynamics = tx.compile(tx.System(rates={p: v, v: F / m - 1.0, m: -0.1 * F}))
    once: dict[str, Any] = {"final_time": (0.3, 4.0), **HEUN}
    first = Phase(dynamics, nodes=6, initial={p: 0.0, v: 0.0, m: 2.0}, final=[m == 1.6], name="boost", **once)
    last = Phase(dynamics, tx.Minimize(tx.Time()), nodes=7, final=[p == target, v == 0.0], name="climb", **once)
    return Problem([first, last], links=[{m: m - 0.5}])


@functools.cache
def tumbling() -> Problem:
    """A ball turns towards the identity, and its rate halves when a boom is extended; it follows rates by node then."""
    system = spinning_ball()
    R, w, u = *system.states, *system.controls
    dynamics, reference = tx.compile(system), tx.Parameter("reference", (3,), value=np.zeros(3))
    away = w - reference
    track = tx.Minimize(5.0 * (3.0 - tx.linalg.Trace(R)), running=u @ u + away @ away)
    start = {R: tx.lie.so3.exp(np.array([0.3, -0.5, 0.4])), w: np.array([0.1, 0.2, -0.3])}
    first = Phase(dynamics, tx.Minimize(running=u @ u), nodes=5, final_time=1.0, initial=start, **HEUN)
    last = Phase(dynamics, track, nodes=6, final_time=1.5, by_node=[reference], name="extended", **HEUN)
    return Problem([first, last], links=[{w: 0.5 * w}])


@functools.cache
def smooth(spline: Spline = LINEAR) -> Problem:
    """A mass is brought to rest by a continuous force with limits."""
    p, v, u = tx.State("p"), tx.State("v", min=-2.0), tx.Control("u", min=-0.8, max=0.8)
    cost = tx.Minimize(5.0 * (p * p + v * v), running=p * p + v * v + 0.1 * u * u)
    start: dict[str, Any] = {"initial": {p: 1.0, v: 0.5}, "controls": spline}
    return Problem(tx.compile(tx.System(rates={p: v, v: u})), cost, nodes=13, final_time=3.0, **start, **HEUN)


def differences(controller: Controller, x: dict[str, float], name: str, step: float = 1e-5) -> np.ndarray:
    """Derivatives of a first control by differences of solves."""
    moved = lambda key, side: controller.feedback(x | {key: x[key] + side * step})[name]  # noqa: E731
    return np.stack([(moved(key, 1.0) - moved(key, -1.0)) / (2.0 * step) for key in x], axis=-1)


def runs_as_in_python(
    controller: Controller, folder: Path, *flags: str, multipliers: float = 1e-9, **options: Any
) -> str:
    """The header, after the test program has compared iterates. Multipliers of the dynamics may differ by so much."""
    files = controller.to_c(folder, name="loop", tolerance=1e-9, **options)
    target, warnings = folder / "test", ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror"]
    command = ["gcc", *warnings, *flags, str(files.source), str(files.test), "-lm", "-o", str(target)]
    built = subprocess.run(command, capture_output=True, text=True)
    assert built.returncode == 0, built.stderr
    ran = subprocess.run([str(target)], capture_output=True, text=True)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert "status 0" in ran.stdout
    apart = [float(number) for number in re.findall(r"multipliers (\S+)", ran.stdout)]
    assert 0.0 <= max(apart) < multipliers
    return files.header.read_text()


def test_feedback_of_phases_is_the_solve_from_the_measured_state(tmp_path: Path) -> None:
    controller, x = full(two_burns()), {"p": 0.02, "v": -0.05, "m": 1.99}
    u = controller.feedback(x)
    expected = two_burns().solve(initial={"boost": x}, tolerance=1e-10)
    assert controller.status is Status.SOLVED
    np.testing.assert_allclose(u["F"], expected.phases[0].us["F"][0], atol=1e-6)
    for plan, phase in zip(controller.phases, expected.phases, strict=True):
        np.testing.assert_allclose(plan.xs["m"], phase.xs["m"], atol=1e-6)
        np.testing.assert_allclose(plan.us["F"], phase.us["F"], atol=1e-5)
        np.testing.assert_allclose(plan.ts, phase.ts, atol=1e-6)
    controller.prepare({"target": 3.5}, final_time={"boost": (1.5, 2.0)}, limits={"climb": {"F": (0.1, 2.9)}})
    controller.feedback(x)
    boost, climb = controller.phases
    assert controller.status is Status.SOLVED
    assert boost.ts[-1] == pytest.approx(1.5, abs=1e-6)
    assert climb.xs["p"][-1] == pytest.approx(3.5, abs=1e-8)
    assert (climb.us["F"].min(), climb.us["F"].max()) == pytest.approx((0.1, 2.9), abs=1e-5)
    assert controller.gains["F"].shape == (3,)
    for call, match in (
        (controller.shift, "several phases.*\n.*final_time"),
        (lambda: controller.xs, r"controller.phases\[0\].xs"),
        (lambda: controller.prepare(limits={"F": (0.0, 1.0)}), "limits names 'F'; the phases are: 'boost', 'climb'"),
        (lambda: controller.prepare(final_time={"boost": 1.0}), "limits .low, high., because it is free"),
    ):
        with pytest.raises(tx.TwistaxError, match=match):
            call()
    if shutil.which("gcc"):
        header = runs_as_in_python(full(two_burns()), tmp_path, "-O0")
        assert "boost: 6 nodes from z[0] on, 4 entries each: p 0, v 1, m 2, F 3" in header
        assert "climb: 7 nodes from z[23] on" in header
        assert "loop_shift" not in header


def test_a_continuous_control_is_applied_as_its_first_value() -> None:
    controller, x = full(smooth()), {"p": -0.4, "v": 0.2}
    u = controller.feedback(x)["u"]
    expected = smooth().solve(initial=x, tolerance=1e-10).us["u"]
    assert controller.status is Status.SOLVED
    assert u == pytest.approx(float(expected[0]), abs=1e-7)
    np.testing.assert_allclose(controller.us["u"], expected, atol=1e-6)
    np.testing.assert_allclose(controller.gains["u"], differences(controller, x, "u"), rtol=1e-3)
    controller.feedback(x)
    newer = {"p": -0.41, "v": 0.21}
    corrected = controller.correct(newer)["u"]
    assert corrected == pytest.approx(float(controller.feedback(newer)["u"]), abs=1e-4)
    us, xs = controller.us["u"], controller.xs
    controller.shift()
    np.testing.assert_array_equal(controller.us["u"], [*us[1:], us[-1]])
    np.testing.assert_array_equal(controller.xs["p"][:-1], xs["p"][1:])
    assert controller.xs["v"][-1] - xs["v"][-1] == pytest.approx(0.25 * us[-1], abs=1e-12)
    limits = np.full(13, 0.1)
    limits[6:] = 0.8
    controller.prepare(limits={"u": (-limits, limits)})
    controller.feedback(x)
    assert np.abs(controller.us["u"])[:6].max() == pytest.approx(0.1, abs=1e-6)
    assert np.abs(controller.us["u"])[6:].max() > 0.11


@pytest.mark.thorough
@pytest.mark.skipif(not shutil.which("gcc"), reason="no gcc")
def test_durations_in_c_count(tmp_path: Path) -> None:
    controller, x = full(two_burns()), {"p": 0.02, "v": -0.05, "m": 1.99}
    files = controller.to_c(tmp_path, name="loop")
    target = tmp_path / "loop.so"
    command = ["gcc", "-O0", "-shared", "-fPIC", str(files.source), "-lm", "-o", str(target)]
    subprocess.run(command, check=True)
    library, size = ctypes.CDLL(str(target)), re.search(r"Workspace: (\d+)", files.header.read_text())
    memory, thrust, limits = np.zeros(int(size[1]) // 8), np.zeros(1), np.array([[1.5, 2.0], [0.3, 4.0]])  # type: ignore[index]
    pointers = lambda *arrays: [ctypes.c_void_p(a.ctypes.data) for a in arrays]  # noqa: E731
    library.loop_init(*pointers(memory))
    for wrong in ([[2.0, 1.5], [0.3, 4.0]], [[1.5, 2.0], [0.0, 4.0]], [[1.5, np.nan], [0.3, 4.0]]):
        before = memory.copy()
        assert library.loop_durations(*pointers(memory, np.array(wrong))) == 7
        np.testing.assert_array_equal(memory, before)
    assert library.loop_durations(*pointers(memory, limits)) == 0
    states = [np.array([value]) for value in x.values()]
    assert library.loop_feedback(*pointers(memory, *states, thrust), None, None, None) == 0
    controller.prepare(final_time={"boost": (1.5, 2.0)})
    controller.feedback(x)
    np.testing.assert_allclose(memory[: len(controller.prepared.z)], controller.prepared.z, rtol=0.0, atol=1e-9)
    assert controller.phases[0].ts[-1] == pytest.approx(1.5, abs=1e-6)


@pytest.mark.thorough
def test_gains_and_data_of_phases_on_a_manifold() -> None:
    controller = full(tumbling())
    x = {"R": np.asarray(tx.lie.so3.exp(np.array([-0.4, 0.2, 0.9]))), "w": np.array([0.0, 0.5, 0.1])}
    reference = 0.3 * np.arange(18.0).reshape(6, 3) / 17.0
    times = {"phase 0": 0.7, "extended": 1.4}
    controller.prepare({"reference": reference}, final_time=times)
    u = controller.feedback(x)["u"]
    options: dict[str, Any] = {"params": {"reference": reference}, "final_time": times, "tolerance": 1e-10}
    solve = lambda x: tumbling().solve(initial={"phase 0": x}, **options).phases  # noqa: E731
    np.testing.assert_allclose(u, solve(x)[0].us["u"][0], atol=1e-6)
    np.testing.assert_allclose(controller.phases[1].ts, np.linspace(0.7, 2.1, 6))
    np.testing.assert_allclose(controller.phases[1].xs["w"][0], 0.5 * controller.phases[0].xs["w"][-1], atol=1e-9)
    gains, step = controller.gains["u"], 1e-5
    assert gains.shape == (3, 6)
    for k, d in enumerate(step * np.eye(6)):
        moved = [
            {"R": x["R"] @ np.asarray(tx.lie.so3.exp(side * d[:3])), "w": x["w"] + side * d[3:]} for side in (1, -1)
        ]
        up, down = (controller.feedback(y)["u"] for y in moved)
        np.testing.assert_allclose(gains[:, k], (up - down) / (2.0 * step), rtol=1e-3, atol=5e-4)


@pytest.mark.thorough
@pytest.mark.skipif(not shutil.which("gcc"), reason="no gcc")
def test_phases_in_c_use_the_memory_that_the_header_states(tmp_path: Path) -> None:
    flags = ("-O0", "-fsanitize=undefined,address", "-fno-sanitize-recover")
    header = runs_as_in_python(full(tumbling()), tmp_path, *flags, memory=0)
    size = re.search(r"Workspace: (\d+)", header)[1]  # type: ignore[index]
    check = tmp_path / "size.c"
    check.write_text(f'#include "loop.h"\ntypedef char exact[sizeof(loop_controller) == {size} ? 1 : -1];\nexact x;\n')
    subprocess.run(["gcc", "-c", str(check), "-o", str(tmp_path / "size.o")], check=True)


def test_a_controller_is_neither_batched_nor_differentiated() -> None:
    controller = Controller(two_burns())
    thrust = lambda p: controller.feedback({"p": p, "v": 0.0, "m": 2.0})["F"]  # noqa: E731
    batched = lambda p: jax.vmap(thrust)(jnp.array([p, p]))  # noqa: E731
    for transformed in (jax.grad(thrust), jax.grad(jax.jit(thrust)), jax.jacfwd(thrust), batched):
        with pytest.raises(TrajectoryError, match=r"(?s)\.feedback changes the plan.*tx\.trajectory\.solution"):
            transformed(1.0)


def test_the_message_names_the_limits_that_the_measured_state_violates() -> None:
    controller = full(regulator())
    controller.feedback({"p": 1.0, "v": -3.0})
    assert controller.status in (Status.STALLED, Status.MAX_ITERATIONS)
    assert controller.message == f"{controller.status}. The measured state violates 'v >= -2' by 1."
    controller.feedback({"p": 1.0, "v": 0.5})
    assert controller.message == f"{Status.SOLVED}."
