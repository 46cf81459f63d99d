"""Controllers in C: the iterates of Python, in memory that the header states, without allocation."""

import ctypes
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_controller import full, pointing, regulator
from test_controllers_with_phases import smooth, tumbling

import twistax as tx
from twistax.trajectory import Problem

pytestmark = pytest.mark.skipif(not shutil.which("gcc"), reason="no gcc")
COMPILE = ("gcc", "-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror")


def workspace(header: str) -> int:
    """Bytes."""
    return int(re.search(r"Workspace: (\d+)", header)[1])  # type: ignore[index]


def built(command: list[str]) -> None:
    done = subprocess.run([*COMPILE, *command], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("flags", [("-O0",), ("-O0", "-fsanitize=undefined,address", "-fno-sanitize-recover")])
@pytest.mark.parametrize(("problem", "memory"), [(regulator, 0), (pointing, 256 * 1024)], ids=["regulator", "pointing"])
def test_iterates_are_those_of_python(problem: Any, memory: int, flags: tuple[str, ...], tmp_path: Path) -> None:
    controller = full(problem())
    before = controller.us["u"]
    files = controller.to_c(tmp_path, name="loop", memory=memory)
    np.testing.assert_array_equal(controller.us["u"], before)
    assert len(controller.log) == 0
    target = tmp_path / "test"
    built([*flags, str(files.source), str(files.test), "-lm", "-o", str(target)])
    ran = subprocess.run([str(target)], capture_output=True, text=True)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert ran.stdout.count("status 0") == 5


def test_it_allocates_nothing_and_has_the_size_that_the_header_states(tmp_path: Path) -> None:
    controller = regulator().controller(max_iterations=3)
    files = controller.to_c(tmp_path, name="loop", memory=0)
    made = tmp_path / "loop.o"
    built(["-O0", "-c", str(files.source), "-o", str(made)])
    names = subprocess.run(["nm", str(made)], capture_output=True, text=True, check=True).stdout
    undefined = set(re.findall(r" U (\w+)", names))
    assert undefined <= {"memcpy", "memset", "log", "log10", "pow", "sqrt", "fabs"}
    external = re.findall(r" [TDBRC] (\w+)", names)
    assert all(name.startswith("loop_") for name in external)
    header = files.header.read_text()
    size = workspace(header)
    assert "at most 3 iterations" in header
    assert size < 19_500  # derivatives are taken in memory of the linear system, few intervals at a time
    check = tmp_path / "size.c"
    check.write_text(f'#include "loop.h"\ntypedef char exact[sizeof(loop_controller) == {size} ? 1 : -1];\nexact x;\n')
    built(["-c", str(check), "-o", str(tmp_path / "size.o")])
    fast = workspace(controller.to_c(tmp_path / "fast", name="loop").header.read_text())
    assert 1.1 * size < fast < 256 * 1024  # all intervals together
    assert workspace(controller.to_c(tmp_path / "less", name="loop", memory=fast - 1).header.read_text()) == size


def test_in_single_precision_plans_are_those_of_double(tmp_path: Path) -> None:
    """A file without doubles, in half of the memory, whose plans differ by rounding; nothing is promoted."""
    controller = full(regulator())
    double = controller.to_c(tmp_path / "double", name="loop", memory=0)
    files = controller.to_c(tmp_path, name="loop", memory=0, dtype=np.float32)
    header, source = files.header.read_text(), files.source.read_text()
    assert "double" not in header + source
    assert workspace(header) < 0.55 * workspace(double.header.read_text())
    target, made = tmp_path / "test", tmp_path / "loop.o"
    single = ["-O0", "-Wdouble-promotion", "-Wfloat-conversion"]
    checked = ["-fsanitize=undefined,address", "-fno-sanitize-recover"]
    built([*single, *checked, str(files.source), str(files.test), "-lm", "-o", str(target)])
    ran = subprocess.run([str(target)], capture_output=True, text=True)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert ran.stdout.count("status 0") == 5
    built([*single, "-c", str(files.source), "-o", str(made)])
    names = subprocess.run(["nm", str(made)], capture_output=True, text=True, check=True).stdout
    assert set(re.findall(r" U (\w+)", names)) <= {"memcpy", "memset", "logf", "log10f", "powf", "sqrtf"}
    with pytest.raises(tx.InputError, match="dtype expects float64 or float32, got int64"):
        controller.to_c(tmp_path, name="loop", dtype=np.int64)


def test_gains_and_statuses_in_single_precision(tmp_path: Path) -> None:
    controller = full(regulator())
    files = controller.to_c(tmp_path, name="loop", dtype=np.float32)
    target = tmp_path / "loop.so"
    built(["-O0", "-shared", "-fPIC", str(files.source), "-lm", "-o", str(target)])
    library, header = ctypes.CDLL(str(target)), files.header.read_text()
    of_solve, of_gains = (np.zeros(int(n) // 4, np.float32) for n in re.findall(r"(\d+) bytes", header))
    pointers = lambda *arrays: [ctypes.c_void_p(a.ctypes.data) for a in arrays]  # noqa: E731
    p, v, u, gains, report = (np.array(a, np.float32) for a in ([0.1], [0.0], [0.0], [0.0, 0.0], np.zeros(5)))
    library.loop_init(*pointers(of_solve))
    assert library.loop_feedback(*pointers(of_solve, p, v, u), None, None, *pointers(report)) == 0
    expected = controller.feedback({"p": 0.1, "v": 0.0})["u"]
    assert u[0] == pytest.approx(float(expected), abs=1e-3)
    status, (_, violation, error) = report[:1].view(np.int32)[0], report[2:]
    allowed = re.search(r"error is at most (\S+) and its violation at most (\S+),", header)
    assert allowed is not None
    assert status == 0
    assert error <= float(allowed[1])
    assert violation <= float(allowed[2])
    assert library.loop_gains(*pointers(of_solve, of_gains, gains)) == 0
    np.testing.assert_allclose(gains, controller.gains["u"].ravel(), rtol=1e-2)
    plan, p[0] = of_solve.copy(), np.nan
    assert library.loop_feedback(*pointers(of_solve, p, v, u), None, None, None) == 4
    np.testing.assert_array_equal(of_solve, plan)


def test_parameters_and_time_limits_count(tmp_path: Path) -> None:
    controller = full(regulator())
    files = controller.to_c(tmp_path, name="loop")
    target = tmp_path / "loop.so"
    built(["-O0", "-shared", "-fPIC", str(files.source), "-lm", "-o", str(target)])
    library = ctypes.CDLL(str(target))
    memory = np.zeros(workspace(files.header.read_text()) // 8)
    pointer = lambda a: ctypes.c_void_p(a.ctypes.data)  # noqa: E731
    library.loop_init(pointer(memory))
    reference, weight, u = np.linspace(0.0, 2.0, 13), np.array([0.3]), np.zeros(1)
    order = re.search(r"loop_prepare\((.*)\)", files.header.read_text())[1]  # type: ignore[index]
    values = {"p_reference": reference, "p_weight": weight}
    names = re.findall(r"\*(p_\w+)", order)
    library.loop_prepare(pointer(memory), *(pointer(values[name]) for name in names))
    numbers = [np.array([value]) for value in (1.2, 0.3, -3.0, 0.0)]
    state, far = [pointer(a) for a in numbers[:2]], [pointer(a) for a in numbers[2:]]
    status = library.loop_feedback(pointer(memory), *state, pointer(u), None, None, None)
    controller.prepare({"reference": reference, "weight": 0.3})
    expected = controller.feedback({"p": 1.2, "v": 0.3})["u"]
    assert status == 0
    assert u[0] == pytest.approx(float(expected), abs=1e-10)
    plan, nothing = memory.copy(), pointer(np.array([np.nan]))
    assert library.loop_feedback(pointer(memory), state[0], nothing, pointer(u), None, None, None) == 4
    assert u[0] == pytest.approx(float(expected), abs=1e-10)
    np.testing.assert_array_equal(memory, plan)
    calls = []

    def is_late(clock: Any) -> int:
        calls.append(clock)
        return int(len(calls) > 2)

    late = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p)(is_late)
    assert library.loop_feedback(pointer(memory), *far, pointer(u), late, None, None) == 6
    assert len(calls) == 3
    library.loop_init(pointer(memory))
    assert library.loop_feedback(pointer(memory), *state, pointer(u), None, None, None) == 0
    assert u[0] == pytest.approx(float(full(regulator()).feedback({"p": 1.2, "v": 0.3})["u"]), abs=1e-10)


def test_a_sine_is_computed_once_for_values_and_derivatives(tmp_path: Path) -> None:
    a, w, u = tx.State("a"), tx.State("w"), tx.Control("u")
    dynamics = tx.compile(tx.System(rates={a: w, w: u - tx.Sin(a)}))
    problem = Problem(dynamics, tx.Minimize(running=a * a + u * u), nodes=3, final_time=1.0, initial={a: 1.0, w: 0.0})
    files = problem.to_c(tmp_path, name="loop", max_iterations=50)
    text, target = files.source.read_text(), tmp_path / "test"
    assert text.count(" sin(") == text.count(" cos(") == 1
    built(["-O0", str(files.source), str(files.test), "-lm", "-o", str(target)])
    ran = subprocess.run([str(target)], capture_output=True, text=True)
    assert ran.returncode == 0, ran.stdout + ran.stderr


def test_functions_without_a_form_in_scalars_are_refused(tmp_path: Path) -> None:
    p, u, A = tx.State("p", shape=(20,)), tx.Control("u", shape=(20,)), tx.Parameter("A", value=np.eye(20))
    dynamics = tx.compile(tx.System(rates={p: tx.linalg.Solve(A, u)}))
    cost = tx.Minimize(running=p @ p + u @ u)
    problem = Problem(dynamics, cost, nodes=3, final_time=1.0, initial={p: np.ones(20)}, substeps=1)
    with pytest.raises(tx.TrajectoryError, match="rate_value has no scalar form"):
        problem.to_c(tmp_path)


@pytest.mark.parametrize("problem", [regulator, pointing, smooth, tumbling])
def test_gains_are_those_of_python(problem: Any, tmp_path: Path) -> None:
    controller = full(problem())
    nodes = controller.phases[0].xs
    x = {name: values[1] for name, values in nodes.items()}
    files = controller.to_c(tmp_path, name="loop")
    target = tmp_path / "loop.so"
    built(["-O0", "-shared", "-fPIC", str(files.source), "-lm", "-o", str(target)])
    library, header = ctypes.CDLL(str(target)), files.header.read_text()
    of_solve, of_gains = (np.zeros(int(n) // 8) for n in re.findall(r"(\d+) bytes", header))
    pointers = lambda *arrays: [ctypes.c_void_p(a.ctypes.data) for a in arrays]  # noqa: E731
    library.loop_init(*pointers(of_solve))
    states, u = [np.ascontiguousarray(a, float) for a in x.values()], np.zeros(controller.phases[0].us["u"][0].size)
    assert library.loop_feedback(*pointers(of_solve, *states, u), None, None, None) == 0
    controller.feedback(x)
    expected = controller.gains["u"]
    gains = np.zeros(expected.shape)
    assert library.loop_gains(*pointers(of_solve, of_gains, gains)) == 0
    np.testing.assert_allclose(gains, expected, rtol=1e-8, atol=1e-8)
    newer = {name: values[2] for name, values in nodes.items()}
    states = [np.ascontiguousarray(a, float) for a in newer.values()]
    assert library.loop_correct(*pointers(of_solve, *states, gains, u)) == 0
    np.testing.assert_allclose(u, np.ravel(controller.correct(newer)["u"]), atol=1e-8)
    states[0][...] = np.nan
    assert library.loop_correct(*pointers(of_solve, *states, gains, u)) == 4
