"""Expressions at physical magnitudes outside of transformations of JAX: C code, CasADi, integrations, `linearize`."""

import ctypes
import importlib.util
import shutil
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import magnitudes
import numpy as np
from magnitudes import SIZE, Part

import twistax as tx

#: What is at hand; the others are left out.
COMPILER = next((c for c in ("gcc", "clang") if shutil.which(c)), None)
WAYS = [
    *(("C float32", "C float64") if COMPILER else ()),
    *(("CasADi",) if importlib.util.find_spec("casadi") else ()),
    "integrate",
    "linearize",
]


def results(state: np.ndarray, parts: Sequence[Part], way: str) -> Iterator[tuple[str, int, np.ndarray]]:
    """(path, order of the derivative, the number) by a way."""
    z = tx.State("z", shape=(SIZE,))
    rate = magnitudes.rate_of(z, parts)
    dynamics = tx.compile(tx.System({z: rate}))
    if way.startswith("C "):
        values, slopes = in_c(dynamics, state, np.dtype(way[2:]))
    elif way == "CasADi":
        values, slopes = in_casadi(dynamics, state)
    elif way == "integrate":
        values, slopes = integrated(z, rate, state)
    else:
        point = {"z": state}
        values, slopes = dynamics(0.0, point)["z"], tx.trajectory.linearize(dynamics, 0.0, point, {}).A
    yield way, 0, np.asarray(values)
    yield f"{way}, derivative", 1, np.asarray(slopes)


def in_c(dynamics: tx.Dynamics, state: np.ndarray, dtype: np.dtype[Any]) -> tuple[np.ndarray, np.ndarray]:
    """Values and Jacobian by code that the compiler at hand has compiled."""
    with tempfile.TemporaryDirectory(prefix="magnitudes_") as folder:
        dynamics.to_c(folder, name="drawn", dtype=dtype, jacobian=("x",))
        library = Path(folder) / "drawn.so"
        source = str(Path(folder) / "drawn.c")
        command = [str(COMPILER), "-std=c99", "-O1", "-shared", "-fPIC", source, "-lm", "-o", str(library)]
        subprocess.run(command, check=True, capture_output=True)
        code = ctypes.CDLL(str(library))
        real = ctypes.c_float if dtype == np.float32 else ctypes.c_double
        own, found = np.ascontiguousarray(state, dtype), (np.zeros(SIZE, dtype), np.zeros((SIZE, SIZE), dtype))
        for function, result in zip(("rates", "jacobian"), found, strict=True):
            getattr(code, f"drawn_{function}")(real(0.0), *(ctypes.c_void_p(a.ctypes.data) for a in (own, result)))
        return found


def in_casadi(dynamics: tx.Dynamics, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values and Jacobian by CasADi, in double precision."""
    function, given = dynamics.to_casadi(), {"t": 0.0, "z": state.astype(float)}
    values = function(**given)["rate_z"]
    slopes = function.jacobian()(**given, **{f"out_{name}": 0 for name in function.name_out()})["jac_rate_z_z"]
    return np.array(values).reshape(-1), np.array(slopes)


def integrated(z: tx.State, rate: tx.Expr, state: np.ndarray) -> tuple[Any, Any]:
    """What one step of one second by Euler's method adds to zero: the rate itself."""
    v = tx.State("v", shape=(SIZE,))
    dynamics = tx.compile(tx.System({z: 0.0 * z, v: rate}))

    def end(z: jax.Array) -> jax.Array:
        x = {"z": z, "v": jnp.zeros_like(z)}
        return tx.integrate(dynamics, x, t1=1.0, dt=1.0, method=tx.RKMK(tx.tableaus.EULER)).xs["v"][-1]

    return end(jnp.asarray(state)), jax.jacfwd(end)(jnp.asarray(state))


def wrong(state: np.ndarray, parts: Sequence[Part], way: str) -> str:
    """What is wrong by a way, in a line for each path; nothing if nothing is."""
    said = [magnitudes.off(name, order, found, parts) for name, order, found in results(state, parts, way)]
    return "\n".join(filter(None, said))
