"""The contenders of other packages: OpenSCvx, Pinocchio, and C code of CasADi."""

import ctypes
import functools
import re
import subprocess
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np

from ...mechanics import Chain
from ...mechanics.flight import numbers
from ...scenes.scene import cross_matrix
from ..harness.timing import Timed, repeated
from .cases import CENTER, MASS, EvaluatedFunction, inertia
from .contenders import (
    ARRAYS,
    CALLS,
    JACOBIAN,
    NATIVE,
    NATIVE_ALONE,
    PLAIN,
    SCALARS,
    TINY,
    VALUE,
    Contender,
    DerivativeKind,
    Function,
    JaxTask,
    Lacks,
    Task,
)


def _openscvx(case: EvaluatedFunction, quantity: DerivativeKind) -> Task:
    import openscvx as ox
    from openscvx.symbolic.lower import lower_to_jax

    if case.chain is not None:
        raise Lacks("its lowering duplicates shared subexpressions, so a recursion grows with each link")
    p, q, V = ox.State("p", shape=(3,)), ox.State("q", shape=(4,)), ox.State("V", shape=(6,))
    F = ox.Control("F", shape=(6,))
    for leaf, place in ((p, slice(0, 3)), (q, slice(3, 7)), (V, slice(7, 13)), (F, slice(0, 6))):
        leaf._slice = place
    arm, R = cross_matrix(MASS * CENTER), ox.spatial.QDCM(q)
    down = R.T @ np.array([0.0, 0.0, -9.81])
    # Its coadjoint operator is right for a momentum ordered [L; p].
    coriolis = ox.lie.AdjointDual(V, np.roll(inertia(), 3, axis=0) @ V)
    wrench = ox.Concat(F[:3] + MASS * down - coriolis[3:], F[3:] + arm @ down - coriolis[:3])
    rates = ox.Concat(R @ V[:3], 0.5 * ox.spatial.SSMP(V[3:]) @ q, np.linalg.inv(inertia()) @ wrench)

    def make() -> Function:
        lowered = lower_to_jax(rates)
        return quantity.by_jax(lambda a, b, c: [lowered(jnp.concatenate([a, b]), c, 0, {})])

    return JaxTask(case, make)


OPENSCVX = Contender("OpenSCvx", "C2", _openscvx, package="openscvx")

# ---- Pinocchio ------------------------------------------------------------------------------------------------------


class PointwiseTask:
    """A task that is no JAX function: a call for one point, and a loop and a batch that write into an array."""

    def __init__(
        self, case: EvaluatedFunction, quantity: DerivativeKind, seconds: float, *how: Any, wrap: Any = np.asarray
    ) -> None:
        self._case, self._shape, self._seconds = case, quantity.shape(case), seconds
        (self._call, self._loop, self._batch), self._wrap = how, wrap

    def single(self) -> Timed:
        arguments = [self._wrap(points[0]) for points in self._case.points(1)]
        return Timed(lambda: self._call(*arguments), CALLS, self._seconds)

    def loop(self, steps: int) -> Timed:
        return self._into(np.zeros(self._shape), self._loop, [a[0] for a in self._case.points(1)], steps, steps, TINY)

    def batch(self, count: int) -> Timed:
        out = np.zeros((count, *self._shape))
        return self._into(out, self._batch, self._case.points(count), count, count)

    def _into(self, out: Any, call: Any, points: Sequence[Any], evaluations: int, *counts: Any) -> Timed:
        arguments = [np.ascontiguousarray(values) for values in points]

        def run() -> Any:
            call(*counts, *arguments, out)
            return out

        return Timed(run, evaluations, self._seconds)


def pinocchio_model(chain: Chain) -> Any:
    """A chain as a model of Pinocchio; all joints turn about z."""
    import pinocchio as pin

    model, before = pin.Model(), 0
    for link, body in zip(chain.links, chain.bodies.values(), strict=True):
        mount = numbers(link.mount)
        before = model.addJoint(before, pin.JointModelRZ(), pin.SE3(mount[:3, :3], mount[:3, 3]), link.name)
        of_body = pin.Inertia(float(numbers(body.mass)), numbers(body.center_of_mass), numbers(body.inertia))
        model.appendBodyToJoint(before, of_body, pin.SE3.Identity())
    return model


def _pinocchio(case: EvaluatedFunction, quantity: DerivativeKind) -> Task:
    import pinocchio as pin

    if case.chain is None:
        raise Lacks("it has no function with quaternion rates")
    if quantity not in (VALUE, JACOBIAN):
        raise Lacks("it has Jacobians only")
    begin, model, inverse = time.perf_counter(), pinocchio_model(case.chain()), case.inverse
    data = model.createData()

    def slopes(q: Any, qd: Any, third: Any) -> Any:
        (pin.computeRNEADerivatives if inverse else pin.computeABADerivatives)(model, data, q, qd, third)
        return np.concatenate([data.dtau_dq, data.dtau_dv] if inverse else [data.ddq_dq, data.ddq_dv], axis=1)

    call = slopes if quantity is JACOBIAN else functools.partial(pin.rnea if inverse else pin.aba, model, data)

    def loop(steps: int, tiny: float, *arguments: Any) -> None:
        *fed, out = arguments
        for _ in range(steps):
            out[...] = call(*fed)
            for argument in fed:
                argument += tiny * out.reshape(-1)[: argument.size]

    def batch(count: int, a: Any, b: Any, c: Any, out: Any) -> None:
        for i in range(count):
            out[i] = call(a[i], b[i], c[i])

    seconds = time.perf_counter() - begin
    return PointwiseTask(case, quantity, seconds, functools.partial(repeated, CALLS, call), loop, batch)


PINOCCHIO = Contender("Pinocchio", "C4", _pinocchio, package="pin", module="pinocchio")

# ---- CasADi: a function of SX symbols, C written from it, compiled with gcc and called in a C loop ------------------

_FLAGS = ("-O3", "-march=native", "-fPIC", "-shared", "-fopenmp", "-fno-math-errno")
_LOOPS = Path(__file__).with_name("loop.c"), Path(__file__).with_name("lanes.c")

#: Points that vector instructions of 512 bits compute side by side.
LANES = 8

#: Longer, s, and gcc is stopped.
_PATIENCE = 120.0

_VECTOR = np.ctypeslib.ndpointer(np.float64, flags="C_CONTIGUOUS")


def _as_numpy(ca: Any) -> Any:
    """SX symbols under the names of NumPy, with structural zeros."""
    block = lambda rows: ca.vertcat(*(ca.horzcat(*row) for row in rows))  # noqa: E731
    stack = lambda parts: ca.vertcat(*parts)  # noqa: E731
    return SimpleNamespace(
        sin=ca.sin,
        cos=ca.cos,
        dot=ca.dot,
        block=block,
        stack=stack,
        concatenate=stack,
        asarray=lambda value: ca.SX(ca.sparsify(ca.DM(np.asarray(value, float)))),
        array=lambda rows: ca.sparsify(block(rows)),
        outer=lambda a, b: a @ b.T,
    )


def _function(case: EvaluatedFunction, quantity: DerivativeKind) -> Any:
    """The matrices as a function of SX symbols; rows of a Jacobian are together, as ours are."""
    import casadi as ca

    arguments = [ca.SX.sym(name, n) for name, n in zip("abc", case.sizes, strict=True)]
    result, x = ca.vertcat(*case.by_hand(_as_numpy(ca), *arguments)), ca.vertcat(*arguments[:2])
    if quantity is not VALUE:
        # CasADi keeps columns together.
        result = ca.jacobian(result, x).T if quantity is JACOBIAN else ca.gradient(ca.sum1(result), x)
    return ca.Function("evaluated", arguments, [ca.densify(result)])


def in_lanes(source: str) -> str:
    """C of CasADi in which `casadi_real` may be a vector: numbers that are assigned become vectors."""
    source = re.sub(r"(\w+\[\d+\])\? (\1\[\d+\]) : 0;", r"\2;", source)
    source = re.sub(r"=(-?\d[\d.eE+-]*);", r"=(casadi_real){}+\1;", source)
    return re.sub(r"(casadi_real \w+_default_in.*?)return 0;", r"\1return (casadi_real){};", source, flags=re.DOTALL)


def _library(function: Any, sizes: dict[str, int], folder: str, lanes: int, threads: int) -> str:
    """The path of a shared library from the C of a function. Raises Lacks where gcc takes too long."""
    import casadi as ca

    generator = ca.CodeGenerator("evaluated.c")
    generator.add(function)
    source, target = Path(folder, "evaluated.c"), f"{folder}/evaluated.so"
    source.write_text(in_lanes(generator.dump()) if lanes > 1 else generator.dump())
    sizes = sizes | {name: getattr(function, name.lower())() for name in ("SZ_ARG", "SZ_RES", "SZ_IW", "SZ_W")}
    defined = [f"-D{name}={value}" for name, value in (sizes | {"LANES": lanes, "THREADS": threads}).items()]
    defined += ["-DNAME=evaluated", f'-DSOURCE="{source}"']
    words = ["gcc", *_FLAGS, *defined, "-o", target, str(_LOOPS[lanes > 1]), "-lm"]
    try:
        subprocess.run(words, check=True, capture_output=True, timeout=_PATIENCE)
    except subprocess.TimeoutExpired:
        raise Lacks(f"gcc was stopped after {_PATIENCE:g} s on {function.n_instructions():,} operations") from None
    return target


def _casadi(lanes: int, threads: int, case: EvaluatedFunction, quantity: DerivativeKind) -> Task:
    """C code of CasADi, written and compiled once for all uses; in lanes for batches alone."""
    import casadi as ca

    begin, shape, function = time.perf_counter(), quantity.shape(case), _function(case, quantity)
    sizes = dict(zip(("SIZE_A", "SIZE_B", "SIZE_C"), case.sizes, strict=True)) | {"SIZE_OUT": int(np.prod(shape))}
    # What is loaded stays when its file is gone.
    with tempfile.TemporaryDirectory() as folder:
        target = _library(function, sizes, folder, lanes, threads)
        library: Any = ctypes.CDLL(target)
        external: Any = None if lanes > 1 else ca.external("evaluated", target)
    seconds = time.perf_counter() - begin
    library.twistax_batch.argtypes, library.twistax_batch.restype = [ctypes.c_long, *[_VECTOR] * 4], None
    if lanes > 1:
        return PointwiseTask(case, quantity, seconds, _batches_only, _batches_only, library.twistax_batch)
    library.twistax_loop.argtypes = [ctypes.c_long, ctypes.c_double, *[_VECTOR] * 4]
    library.twistax_loop.restype = None

    def calls(*point: Any) -> Any:
        return np.asarray(repeated(CALLS, external, *point).full()).T.reshape(shape)

    return PointwiseTask(case, quantity, seconds, calls, library.twistax_loop, library.twistax_batch, wrap=ca.DM)


def _batches_only(*_: Any) -> Any:
    raise Lacks(f"it computes {LANES} points at a time")


def in_c(name: str, colour: str, lanes: int, threads: int = 1) -> Contender:
    """CasADi's C, for some points side by side and in some threads."""
    return Contender(name, colour, functools.partial(_casadi, lanes, threads), package="casadi", tool="gcc")


CASADI = in_c("CasADi C", "C1", 1)
CASADI_LANES = in_c("CasADi C, 8 lanes", "C6", LANES)

#: All of them, in the order of tables.
ALL = (SCALARS, NATIVE, NATIVE_ALONE, ARRAYS, PLAIN, OPENSCVX, CASADI, CASADI_LANES, PINOCCHIO)
