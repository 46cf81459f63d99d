"""Scalar programs: operations, agreement with arrays, and the cost of their kernels."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

import twistax as tx

from ...scalar.backends import Backend
from ...scalar.derivatives import cotangent_program, jacobian
from ...scalar.jax_primitive import Derived, call_program
from ...scalar.program import ScalarProgram
from ...scalar.reader import one_by_one, scalarize
from ...scalar.targets.llvm.backend import installed
from ..harness.expected import Absent, at_most, between, needed
from ..harness.measurement import MeasuredCase, Section, quick
from ..harness.timing import Repeats, Timed, agree, compiled, difference, in_turn, seconds_of
from ..speed.cases import CASES, EvaluatedFunction
from ..speed.contenders import relative_difference
from .steps import c_body

#: Arrays to a list of arrays.
Function = Callable[..., list[jax.Array]]


@functools.cache
def in_arrays(case: EvaluatedFunction) -> Function:
    """The function of a case, compiled to arrays."""
    return case.run_by(tx.compile(case.system(), backend=tx.JAX()))


@functools.cache
def program_of(case: EvaluatedFunction) -> ScalarProgram:
    """The function of a case as a scalar program."""
    return scalarize(in_arrays(case), *_shapes(case))


def _shapes(case: EvaluatedFunction) -> list[jax.ShapeDtypeStruct]:
    return [jax.ShapeDtypeStruct((n,), float) for n in case.sizes]


@functools.cache
def _slopes(case: EvaluatedFunction) -> ScalarProgram:
    """The Jacobian of a case by its first two arguments, as a scalar program."""
    program = program_of(case)
    return program.restricted([np.array(list(jacobian(program, [0, 1]).values()))])


def _unrolled_in(case: EvaluatedFunction) -> float:
    """Seconds from the jaxpr to the scalar program, the fastest of three."""
    closed = jax.make_jaxpr(in_arrays(case))(*_shapes(case))
    return min(seconds_of(lambda: scalarize(closed)) for _ in range(3))


def disagreement(case: EvaluatedFunction, derivative: bool = False, function: Function | None = None) -> float:
    """The largest difference of values or Jacobians from those of the arrays at 20 random states, relative."""
    derived, splits = Derived(program_of(case)), np.cumsum(case.sizes)[:-1]
    points = jnp.concatenate(list(map(jnp.asarray, case.points(20))), axis=1)

    def evaluated(function: Function) -> NDArray[np.float64]:
        value = lambda z: jnp.concatenate(function(*jnp.split(z, splits)))  # noqa: E731
        return np.asarray(jax.jit(jax.vmap(jax.jacfwd(value) if derivative else value))(points))

    scalars, arrays = evaluated(functools.partial(call_program, derived)), evaluated(function or in_arrays(case))
    return relative_difference(scalars, arrays, rank=2 if derivative else 1)


_MOST = {"free-body": at_most(230), "rnea-7": at_most(1020), "aba-7": at_most(1800)}


def _of_case(case: EvaluatedFunction) -> Section:
    row, short = functools.partial(MeasuredCase, case.title), case.sizes[0] < 30
    limit = between(unit="s") if case.name == "free-body" else at_most(0.1 if short else 1.0, "s")
    rows: Section = [
        row("operations", _MOST.get(case.name, between()), lambda: program_of(case).operations),
        row("unrolled in", limit, _unrolled_in, case),
    ]
    if case.name == "aba-7":
        gradient = lambda: cotangent_program(program_of(case), range(3)).operations  # noqa: E731
        rows += [
            row("operations of its Jacobian by q and qd", at_most(16500), lambda: _slopes(case).operations),
            row("operations of a gradient", at_most(5600), gradient),
        ]
    if short:
        rows += [
            row("difference of values", at_most(1e-13), disagreement, case, slow=True),
            row("difference of Jacobians", at_most(1e-12), disagreement, case, derivative=True, slow=True),
        ]
    return rows


OPERATIONS: Section = [row for case in CASES.values() for row in _of_case(case)]

_PANDA = CASES["aba-7"]


def need_llvmlite() -> None:
    if not installed():
        raise Absent("not run: llvmlite is not installed; pip install llvmlite")


def _build_seconds(make: Callable[[], ScalarProgram]) -> float:
    """Seconds from a scalar program to a batched kernel that was compared with NumPy."""
    need_llvmlite()
    program = make()
    # LLVM is initialised by a first kernel, which is not timed.
    tx.Native().runner.prepare(scalarize(lambda x: [jnp.sin(x)], jax.ShapeDtypeStruct((2,), float)), single=False)
    begin = time.perf_counter()
    if tx.Native().runner.prepare(program, single=False) is None:
        raise RuntimeError("the program has no kernel")
    return time.perf_counter() - begin


def _native(run: Any, *arguments: Any) -> Any:
    """The jitted function. Raises RuntimeError unless it calls a native kernel."""
    if "custom_call @twistax_" not in run.lower(*arguments).as_text():
        raise RuntimeError("no kernel runs the function")
    return run


def _above_an_empty_call() -> float:
    """What a jitted call of the Panda's forward dynamics takes beyond one that adds the three vectors, us."""
    need_llvmlite()
    dynamics = tx.compile(_PANDA.system(), backend=tx.Native())
    point = [jnp.asarray(values[0]) for values in _PANDA.points(1)]
    full = lambda *z: dynamics(0.0, *_PANDA.inputs(*z))["qd"]  # noqa: E731
    _native(jax.jit(full), *point)
    timed = [compiled(function, *point, calls=200) for function in (full, lambda q, qd, tau: q + qd + tau)]
    in_turn(timed, Repeats(31, 31))
    return 1e6 * (timed[0].seconds - timed[1].seconds)


def batch_ratio(count: int = 65_536, steps: int = 1_000) -> float:
    """A batch of RKMK4 integrations of one body: time in a kernel over that by XLA's loop, where the ends agree.

    Both take so long that one call each says enough, the one whose ends are compared.
    """
    need_llvmlite()
    V = np.array([1.0, 0.5, -0.3, 0.4, 1.2, -0.7]) + np.random.default_rng(0).normal(scale=0.1, size=(count, 6))
    start = {"g": jnp.broadcast_to(jnp.eye(4), (count, 4, 4)), "V": jnp.asarray(V)}

    def batch(backend: Backend) -> Any:
        dynamics = c_body(backend)

        def solve(start: Any) -> Any:
            sol = tx.integrate(dynamics, start, t1=1e-3 * steps, steps=steps, throw=False)
            return sol.xs, sol.result

        return jax.jit(jax.vmap(solve))

    runs = [_native(batch(tx.Native()), start), batch(tx.XLA())]
    for run in runs:
        run.lower(start).compile()
    timed = [Timed(functools.partial(run, start)) for run in runs]
    (ends, codes), (reference, reference_codes) = (it.result() for it in timed)
    if not (jnp.all(codes == tx.Result.SUCCESS) and jnp.all(reference_codes == tx.Result.SUCCESS)):
        raise RuntimeError("not all reached the end")
    agree(difference(ends, reference), 1e-11)
    return timed[0].rough / timed[1].rough


def angles(count: int) -> NDArray[np.float64]:
    """Angles of all sizes to 1e9 rad, and those nearest to multiples of a quarter turn, where most cancels."""
    mp, random = needed("mpmath", "mpmath"), np.random.default_rng(1)
    sizes = random.choice([-1.0, 1.0], count) * 10.0 ** random.uniform(-9.0, 9.0, count)
    with mp.workdps(50):
        near = np.array([float(mp.pi * int(k) / 2) for k in random.integers(1, 600_000_000, count)])
    return np.concatenate([sizes, near, np.nextafter(near, 0.0)])


def units_off(x: NDArray[np.float64], backend: Backend, sine: Callable[[tx.Expr], tx.Expr] = tx.Sin) -> float:
    """The worst sine or cosine, in units in the last place, against 50 digits."""
    if isinstance(backend, tx.Native):
        need_llvmlite()
    mp, (s, c) = needed("mpmath", "mpmath"), (tx.State("s"), tx.State("c"))
    dynamics = tx.compile(tx.System(rates={s: sine(s), c: tx.Cos(c)}), backend=backend)
    run = jax.jit(jax.vmap(lambda a: dynamics(0.0, {"s": a, "c": a})))
    results = (_native(run, x) if isinstance(backend, tx.Native) else run)(jnp.asarray(x))
    errors = []
    with mp.workdps(50):
        for name, function in (("s", mp.sin), ("c", mp.cos)):
            for angle, value in zip(x.tolist(), np.asarray(results[name]).tolist(), strict=True):
                exact = function(mp.mpf(angle))
                errors.append(float(abs(value - exact)) / float(np.spacing(abs(float(exact)))))
    return float(np.max(errors))


_BATCH = "65,536 integrations of 1,000 RKMK4 steps, time over that of XLA's loop"
_SINES = "sine and cosine of 90,000 angles up to 1e9 rad, worst"
_panda_slopes = lambda: one_by_one(_slopes(_PANDA))  # noqa: E731
_EMPTY = "a call of it above one that adds its arguments"

KERNELS: Section = [
    quick("building the Panda's ABA", "llvmlite", at_most(0.4, "s"), _build_seconds, lambda: program_of(_PANDA)),
    quick("building its Jacobian", "llvmlite", at_most(4.0, "s"), _build_seconds, _panda_slopes, slow=True),
    quick(_EMPTY, "llvmlite", at_most(1.0, "us"), _above_an_empty_call),
    quick(_BATCH, "llvmlite", at_most(0.3), batch_ratio, slow=True),
    quick(_SINES, "llvmlite", at_most(2.0, "ulp"), lambda: units_off(angles(30_000), tx.Native()), slow=True),
]
