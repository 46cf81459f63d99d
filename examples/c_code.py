"""C99 code of a rigid body: it is written, compiled, tested and called, and its results agree with Python."""

import ctypes
import shutil
import subprocess
import tempfile
from pathlib import Path

import jax
import numpy as np

import twistax as tx

jax.config.update("jax_enable_x64", True)

mass, inertia = 2.0, np.diag([0.02, 0.03, 0.04])  # kg, kg m^2
g, V, F = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,)), tx.Control("F", shape=(6,))
M = tx.Parameter("M", value=np.block([[mass * np.eye(3), np.zeros((3, 3))], [np.zeros((3, 3)), inertia]]))
weight = tx.Concat(mass * (g[:3, :3].T @ np.array([0.0, 0.0, -9.81])), np.zeros(3))  # N, in the body's frame
system = tx.System(rates={g: V, V: tx.linalg.Solve(M, F + weight - tx.lie.AdjointDual(V, M @ V))})
dynamics = tx.compile(system, bake={"M": M.value})

point = {
    "g": np.asarray(tx.pose(position=[1.0, 2.0, 3.0], euler=[0.3, -0.2, 0.5])),
    "V": np.array([1, 0, 2, 0.1, 0, 3.0]),
}
wrench = {"F": np.array([0.0, 0.0, 20.0, 0.01, 0.0, 0.0])}  # N, N m

with tempfile.TemporaryDirectory() as folder:
    files = dynamics.to_c(folder, name="body", points=[(0.0, point, wrench)])
    print("written:", files.header.name, files.source.name, files.test.name)

    compiler = next(filter(None, map(shutil.which, ["cc", "gcc", "clang"])), None)
    if compiler is None:
        print("no C compiler here: nothing to run")
        raise SystemExit(0)
    strict = [compiler, "-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-pedantic"]

    # 1. The test main that was written along.
    test = Path(folder) / "body_test"
    subprocess.run([*strict, str(files.source), str(files.test), "-lm", "-o", str(test)], check=True)
    print(subprocess.run([test], check=True, capture_output=True, text=True).stdout.splitlines()[-1])

    # 2. The same code as a library, called from here: t, states, controls, then the results, row by row.
    library = Path(folder) / "body.so"
    subprocess.run([*strict, "-shared", "-fPIC", str(files.source), "-lm", "-o", str(library)], check=True)
    rates = ctypes.CDLL(str(library)).body_rates
    array = np.ctypeslib.ndpointer(np.float64, flags="C_CONTIGUOUS")
    rates.argtypes, rates.restype = [ctypes.c_double, *[array] * 5], None
    twist, acceleration = np.zeros(6), np.zeros(6)
    rates(0.0, point["g"], point["V"], wrench["F"], twist, acceleration)

expected = dynamics(0.0, point, wrench)
apart = float(np.max(np.abs(acceleration - expected["V"])))
print("acceleration by C (m/s^2, rad/s^2):", np.round(acceleration, 6))
print(f"apart from Python: {apart:.1e}")
if not apart < 1e-12:
    raise SystemExit("C and Python disagree")
