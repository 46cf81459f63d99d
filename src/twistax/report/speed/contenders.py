"""What is timed, a quantity of a case in one of its uses, and who takes part: this package, plain JAX, and peers."""

from __future__ import annotations

import ctypes
import dataclasses
import functools
import importlib.util
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

import twistax as tx

from ...mechanics import Chain
from ...mechanics.flight import numbers
from ...scalar.backends import Backend
from ...scalar.graph import TooLarge
from ...scenes.scene import cross_matrix
from ..timing import Timed, compiled, repeated
from .cases import CENTER, MASS, Case, inertia

#: Calls from Python that are timed together.
CALLS = 20
#: What a loop feeds back is multiplied by this: it changes nothing, and no compiler can know.
TINY = 1e-200
#: Bytes that a program may need beside its arguments and results.
_MEMORY = 8e9

#: Three vectors to arrays, traceable; one after the other along the last axis they are the result.
Function = Callable[[Any, Any, Any], list[Any]]


class Lacks(Exception):
    """A contender has no such task; the message says why."""


def values(timed: Timed) -> NDArray[np.float64]:
    """The results of a call as one array: what comes in parts is joined here, where nothing is timed."""
    parts = jax.tree.leaves(timed.result())
    return np.concatenate([np.asarray(part, np.float64) for part in parts], axis=-1)


class Quantity(NamedTuple):
    """Of a function."""

    name: str  # for tables
    title: str  # for the page
    shape: Callable[[Case], tuple[int, ...]]  # of the result of a case
    by_jax: Callable[[Function], Function]  # of a traceable function


def _jacobian(function: Function) -> Function:
    slopes = jax.jacfwd(lambda a, b, c: jnp.concatenate(function(a, b, c), axis=-1), argnums=(0, 1))
    return lambda a, b, c: list(slopes(a, b, c))


def _gradient(function: Function) -> Function:
    slopes = jax.grad(lambda a, b, c: sum(map(jnp.sum, function(a, b, c))), argnums=(0, 1))
    return lambda a, b, c: list(slopes(a, b, c))


_SLOPES, _TOTAL = "Jacobian by the first two arguments", "gradient of the sum of the results by the first two arguments"
VALUE = Quantity("value", "value", lambda case: (case.results,), lambda function: function)
JACOBIAN = Quantity("jacobian", _SLOPES, lambda case: (case.results, sum(case.sizes[:2])), _jacobian)
GRADIENT = Quantity("gradient", _TOTAL, lambda case: (sum(case.sizes[:2]),), _gradient)
QUANTITIES = (VALUE, JACOBIAN, GRADIENT)

# ---- uses and tasks -------------------------------------------------------------------------------------------------

#: A quantity of a case by a contender: `single()`, `loop(steps)` and `batch(count)`, or they raise `Lacks`.
Task = Any


@dataclasses.dataclass(frozen=True)
class Use:
    """What a task is asked for."""

    name: str
    of: Callable[[Task], Timed]
    count: int = 0  # of points at once; zero if it is no batch


def batch(count: int) -> Use:
    """For many points at once."""
    return Use(f"batch of {count:,}", lambda task: task.batch(count), count)


SINGLE = Use("single call", lambda task: task.single())
LOOP = Use("in a loop", lambda task: task.loop(1000))
USES: tuple[Use, ...] = (SINGLE, LOOP, *map(batch, (64, 4096, 65536)))


class JaxTask:
    """A traceable function under jit, scan and vmap, all as JAX does it by default. It gives the parts of the result.

    It is made anew for each use, so that what is found when it is traced counts as compiling.

    Args:
        around: what becomes of the whole, the loop or the batch too.
    """

    def __init__(self, case: Case, make: Callable[[], Function], around: Callable[[Any], Any] = jax.jit) -> None:
        self._case, self._make, self._around = case, make, around

    def single(self) -> Timed:
        """`CALLS` calls from Python, one after the other, each waited for."""
        return self._compiled(lambda function: function, calls=CALLS)

    def loop(self, steps: int) -> Timed:
        """A compiled loop in which each evaluation waits for the one before."""

        def looped(function: Function) -> Callable[..., Any]:
            def step(carry: tuple[Any, Any], _: None) -> tuple[Any, None]:
                arguments, _before = carry
                result = function(*arguments)
                # The first part is as long as any argument.
                fed = result[0].reshape(-1)
                return (tuple(a + TINY * fed[: a.size] for a in arguments), result), None

            def run(*point: Any) -> Any:
                first = jax.tree.map(lambda r: jnp.zeros(r.shape, r.dtype), jax.eval_shape(function, *point))
                return jax.lax.scan(step, (point, first), None, length=steps)[0][1]

            return run

        return self._compiled(looped, evaluations=steps)

    def batch(self, count: int) -> Timed:
        """Many points at once."""
        return self._compiled(jax.vmap, count, evaluations=count)

    def _compiled(self, use: Callable[[Function], Any], points: int = 0, **counts: int) -> Timed:
        """For one point, or for a batch of them."""
        arguments = [jnp.asarray(each if points else each[0]) for each in self._case.points(points or 1)]
        begin = time.perf_counter()
        function = self._around(use(self._make()))
        made = time.perf_counter() - begin
        timed = compiled(function, *arguments, **counts)
        timed.compile_seconds += made
        if timed.memory > _MEMORY:
            raise Lacks(f"it would need {timed.memory / 1e9:.0f} GB")
        return timed


@dataclasses.dataclass(frozen=True, eq=False)
class Contender:
    """A way to have dynamics evaluated. What is done, a sentence for the page, stands in `sections.toml`."""

    name: str  # in tables
    colour: str  # in figures
    task: Callable[[Case, Quantity], Task]  # raises `Lacks` where there is none
    package: str = ""  # needed, as pip calls it
    module: str = ""  # and as Python does, if another name
    tool: str = ""  # needed, as the command line calls it

    def absent(self) -> str | None:
        """Why it cannot take part on this machine; None if it can."""
        if self.package and importlib.util.find_spec(self.module or self.package) is None:
            return f"{self.package} is not installed"
        return f"there is no {self.tool}" if self.tool and shutil.which(self.tool) is None else None


def _twistax(backend: Backend, case: Case, quantity: Quantity) -> Task:
    """This package with a backend; derivatives by JAX where it does not unroll them itself."""
    system = case.system()

    def make() -> Function:
        dynamics = tx.compile(system, backend=backend)
        if quantity is JACOBIAN and not isinstance(backend, tx.JAX) and _unrolls(dynamics, case):

            def slopes(a: Any, b: Any, c: Any) -> list[jax.Array]:
                blocks = dynamics.jacobian(0.0, *case.inputs(a, b, c), wrt=case.by)
                return [blocks[kind] for kind in case.by]

            return slopes
        return quantity.by_jax(case.run_by(dynamics))

    return JaxTask(case, make)


def _unrolls(dynamics: tx.Dynamics, case: Case) -> bool:
    """Whether `dynamics.jacobian` is of use: it unrolls all scalars, which takes a compiler long beyond some."""
    arguments, inside = [points[0] for points in case.points(1)], dynamics._functions
    try:
        found, _ = inside.rate_jacobian(inside.prepare(0.0, *case.inputs(*arguments)), case.by)
    except TooLarge:
        return False
    return found.program.operations <= tx.XLA().largest


SCALARS = Contender("twistax XLA", "C0", functools.partial(_twistax, tx.XLA()))
NATIVE = Contender("twistax native", "C3", functools.partial(_twistax, tx.Native()), package="llvmlite")
ARRAYS = Contender("twistax arrays", "C9", functools.partial(_twistax, tx.JAX()))


def _plain(case: Case, quantity: Quantity) -> Task:
    return JaxTask(case, lambda: quantity.by_jax(functools.partial(case.by_hand, jnp)))


PLAIN = Contender("plain JAX", "C7", _plain)


def _openscvx(case: Case, quantity: Quantity) -> Task:
    import openscvx as ox
    from openscvx.symbolic.lower import lower_to_jax

    if case.chain is not None:
        raise Lacks("its lowering writes a shared part out again at each use, so a recursion grows with each link")
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


class _Called:
    """What is called point by point, and a loop and a batch that write into an array: as `loop.c` has them."""

    def __init__(self, case: Case, quantity: Quantity, seconds: float, *how: Any, wrap: Any = np.asarray) -> None:
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

    def _into(self, out: Any, call: Any, points: Sequence[Any], evaluations: int, *given: Any) -> Timed:
        arguments = [np.ascontiguousarray(each) for each in points]

        def run() -> Any:
            call(*given, *arguments, out)
            return out

        return Timed(run, evaluations, self._seconds)


def pinocchio_model(chain: Chain) -> Any:
    """A chain as a model of Pinocchio; all joints turn about z."""
    import pinocchio as pin

    model, before = pin.Model(), 0
    for link, body in zip(chain.links, chain.bodies.values(), strict=True):
        mount = numbers(link.mount)
        before = model.addJoint(before, pin.JointModelRZ(), pin.SE3(mount[:3, :3], mount[:3, 3]), link.name)
        own = pin.Inertia(float(numbers(body.mass)), numbers(body.center_of_mass), numbers(body.inertia))
        model.appendBodyToJoint(before, own, pin.SE3.Identity())
    return model


def _pinocchio(case: Case, quantity: Quantity) -> Task:
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
            for each in fed:
                each += tiny * out.reshape(-1)[: each.size]

    def batch(count: int, a: Any, b: Any, c: Any, out: Any) -> None:
        for i in range(count):
            out[i] = call(a[i], b[i], c[i])

    seconds = time.perf_counter() - begin
    return _Called(case, quantity, seconds, functools.partial(repeated, CALLS, call), loop, batch)


PINOCCHIO = Contender("Pinocchio", "C4", _pinocchio, package="pin", module="pinocchio")

# ---- CasADi: a function of SX symbols, C written from it, compiled with gcc and called in a C loop ------------------

_FLAGS = ("-O3", "-march=native", "-fPIC", "-shared")
_LOOP = Path(__file__).with_name("loop.c")

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


def _casadi(case: Case, quantity: Quantity) -> Task:
    """Written and compiled once for all uses. Raises Lacks where gcc takes too long."""
    import casadi as ca

    shape, arguments = quantity.shape(case), [ca.SX.sym(name, n) for name, n in zip("abc", case.sizes, strict=True)]
    result = ca.vertcat(*case.by_hand(_as_numpy(ca), *arguments))
    begin, x = time.perf_counter(), ca.vertcat(*arguments[:2])
    if quantity is not VALUE:
        # CasADi keeps columns together, we rows.
        result = ca.jacobian(result, x).T if quantity is JACOBIAN else ca.gradient(ca.sum1(result), x)
    function, generator = ca.Function("evaluated", arguments, [ca.densify(result)]), ca.CodeGenerator("evaluated.c")
    generator.add(function)
    sizes = dict(zip(("SIZE_A", "SIZE_B", "SIZE_C"), case.sizes, strict=True)) | {"SIZE_OUT": int(np.prod(shape))}
    sizes |= {name: getattr(function, name.lower())() for name in ("SZ_ARG", "SZ_RES", "SZ_IW", "SZ_W")}
    # What is loaded stays when its file is gone.
    with tempfile.TemporaryDirectory() as folder:
        generator.generate(f"{folder}/")
        target, defined = f"{folder}/evaluated.so", [f"-D{name}={value}" for name, value in sizes.items()]
        defined += ["-DNAME=evaluated", f'-DSOURCE="{folder}/evaluated.c"']
        words = ["gcc", *_FLAGS, *defined, "-o", target, str(_LOOP), "-lm"]
        try:
            subprocess.run(words, check=True, capture_output=True, timeout=_PATIENCE)
        except subprocess.TimeoutExpired:
            raise Lacks(f"gcc was stopped after {_PATIENCE:g} s on {function.n_instructions():,} operations") from None
        library, external = ctypes.CDLL(target), ca.external("evaluated", target)
    seconds = time.perf_counter() - begin
    library.twistax_batch.argtypes = [ctypes.c_long, *[_VECTOR] * 4]
    library.twistax_loop.argtypes = [ctypes.c_long, ctypes.c_double, *[_VECTOR] * 4]
    library.twistax_batch.restype = library.twistax_loop.restype = None

    def calls(*point: Any) -> Any:
        return np.asarray(repeated(CALLS, external, *point).full()).T.reshape(shape)

    return _Called(case, quantity, seconds, calls, library.twistax_loop, library.twistax_batch, wrap=ca.DM)


CASADI = Contender("CasADi C", "C1", _casadi, package="casadi", tool="gcc")

#: All of them, in the order of tables.
ALL = (SCALARS, NATIVE, ARRAYS, PLAIN, OPENSCVX, CASADI, PINOCCHIO)
