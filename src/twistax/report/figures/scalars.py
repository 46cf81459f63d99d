"""Scalar programs: their operations, that they agree with arrays, and what kernels made of them cost."""

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

from ...lowering.backends import Backend
from ...lowering.native.backend import installed
from ...lowering.scalar.derivatives import cotangent_program, jacobian
from ...lowering.scalar.primitive import Derived, call_program
from ...lowering.scalar.program import ScalarProgram, one_by_one, scalarize
from ..checks import Absent, Between, Check, Section, agree, at_most
from ..speed.case import CASES, Case
from ..timing import Repeats, Timed, in_turn, ratio
from .maps import mpmath
from .steps import c_body

__all__ = ["KERNELS", "OPERATIONS", "angles", "batch_ratio", "disagreement", "in_arrays", "program_of", "units_off"]

#: Arrays to a list of arrays.
Function = Callable[..., list[jax.Array]]

# ---- operations -----------------------------------------------------------------------------------------------------


@functools.cache
def in_arrays(case: Case) -> Function:
    """The function of a case in arrays."""
    dynamics = tx.compile(case.system(), backend=tx.JAX())

    def function(a: jax.Array, b: jax.Array, c: jax.Array) -> list[jax.Array]:
        rates = dynamics(0.0, *case.inputs(a, b, c))
        return [rates[name] for name in case.rates]

    return function


@functools.cache
def program_of(case: Case) -> ScalarProgram:
    """The scalar program of a case."""
    return scalarize(in_arrays(case), *_shapes(case))


def _shapes(case: Case) -> list[jax.ShapeDtypeStruct]:
    return [jax.ShapeDtypeStruct((n,), float) for n in case.sizes]


def _slopes(case: Case) -> ScalarProgram:
    """Its derivatives by the first two arguments."""
    program = program_of(case)
    return program.restricted([np.array(list(jacobian(program, [0, 1]).values()))])


def _unrolled_in(case: Case) -> float:
    """Seconds from the jaxpr to scalars, the best of three."""
    closed = jax.make_jaxpr(in_arrays(case))(*_shapes(case))
    return min(_seconds(lambda: scalarize(closed)) for _ in range(3))


def _seconds(work: Callable[[], Any]) -> float:
    begin = time.perf_counter()
    work()
    return time.perf_counter() - begin


def disagreement(program: ScalarProgram, function: Function, case: Case, derivative: bool) -> float:
    """The largest difference of values or Jacobians from those of the arrays at 20 random states, relative."""
    derived, splits = Derived(program), np.cumsum(case.sizes)[:-1]

    def flat(function: Function) -> Callable[[jax.Array], jax.Array]:
        value = lambda z: jnp.concatenate(function(*jnp.split(z, splits)))  # noqa: E731
        return jax.jacfwd(value) if derivative else value

    points = jnp.concatenate(list(map(jnp.asarray, case.points(20))), axis=1)
    a, b = (
        np.asarray(jax.jit(jax.vmap(flat(each)))(points)) for each in (lambda *z: call_program(derived, *z), function)
    )
    axes = tuple(range(1, a.ndim))
    return float(np.max(np.max(np.abs(a - b), axis=axes) / np.max(np.abs(b), axis=axes)))


def _of_case(case: Case) -> list[Check]:
    bars = {"free-body": 230, "rnea-7": 1020, "aba-7": 1800}
    count = at_most(bars[case.name]) if case.name in bars else Between()
    unrolling = at_most(0.1 if case.sizes[0] < 30 else 1.0, "s") if case.name != "free-body" else Between(unit="s")
    found = [
        Check(case.title, "operations", lambda: program_of(case).operations, count),
        Check(case.title, "unrolled in", lambda: _unrolled_in(case), unrolling),
    ]
    if case.name == "aba-7":
        found += [
            Check(
                case.title, "operations of its Jacobian by q and qd", lambda: _slopes(case).operations, at_most(16500)
            ),
            Check(
                case.title,
                "operations of a gradient",
                lambda: cotangent_program(program_of(case), range(3)).operations,
                at_most(5600),
            ),
        ]
    if case.sizes[0] < 30:
        found += [
            Check(
                case.title,
                name,
                functools.partial(lambda d: disagreement(program_of(case), in_arrays(case), case, d), derivative),
                at_most(bar),
                slow=True,
            )
            for name, derivative, bar in (("values off", False, 1e-13), ("Jacobian off", True, 1e-12))
        ]
    return found


OPERATIONS = Section(
    "operations",
    "Scalar programs",
    "Operations on scalars once zeros, ones and repeated parts are gone: additions, subtractions, products, divisions, "
    "changes of sign, sines and cosines. Values and Jacobians against the same dynamics in arrays at 20 random states, "
    "relative to the largest entry.",
    {"": [check for case in CASES.values() for check in _of_case(case)]},
    wide=True,
)

# ---- kernels --------------------------------------------------------------------------------------------------------

_PANDA = CASES["aba-7"]


def _need_llvmlite() -> None:
    if not installed():
        raise Absent("not run: llvmlite is not installed; pip install 'twistax[native]'")


def _build_seconds(make: Callable[[], ScalarProgram]) -> float:
    """From the scalars to a kernel for many bodies that was compared with NumPy, s."""
    _need_llvmlite()
    program = make()
    # LLVM is awake then.
    tx.Native().prepare(scalarize(lambda x: [jnp.sin(x)], jax.ShapeDtypeStruct((2,), float)), single=False)
    begin = time.perf_counter()
    if tx.Native().prepare(program, single=False) is None:
        raise RuntimeError("no kernel came of the program")
    return time.perf_counter() - begin


def _native(run: Any, *arguments: Any) -> Any:
    """The same jitted function, seen to call a kernel."""
    if "custom_call @twistax_" not in run.lower(*arguments).as_text():
        raise RuntimeError("no kernel runs the function")
    return run


def _above_an_empty_call() -> float:
    """What a jitted call of the Panda's forward dynamics takes beyond one that adds the three vectors, us."""
    _need_llvmlite()
    dynamics, calls = tx.compile(_PANDA.system(), backend=tx.Native()), 200
    point = [jnp.asarray(each[0]) for each in _PANDA.points(1)]
    full = _native(jax.jit(lambda *z: dynamics(0.0, *_PANDA.inputs(*z))["qd"]), *point)
    empty = jax.jit(lambda q, qd, tau: q + qd + tau)

    def repeated(run: Any) -> Timed:
        def call() -> Any:
            for _ in range(calls):
                result = jax.block_until_ready(run(*point))
            return result

        return Timed(call, calls)

    timed = [repeated(full), repeated(empty)]
    in_turn(timed, Repeats(31, 31))
    return 1e6 * (timed[0].seconds - timed[1].seconds)


@functools.cache
def batch_ratio(count: int = 65_536, steps: int = 1_000, rounds: int = 1) -> tuple[float, float]:
    """A batch of RKMK4 integrations of one body: time in a kernel over that by XLA's loop, and how far ends are apart.

    Raises:
        RuntimeError: no kernel runs them, or not all reach the end.
    """
    _need_llvmlite()
    V = np.array([1.0, 0.5, -0.3, 0.4, 1.2, -0.7]) + np.random.default_rng(0).normal(scale=0.1, size=(count, 6))
    start = {"g": jnp.broadcast_to(jnp.eye(4), (count, 4, 4)), "V": jnp.asarray(V)}

    def batch(backend: Backend) -> Any:
        dynamics = c_body(backend)

        def solve(start: Any) -> Any:
            sol = tx.integrate(dynamics, start, t1=1e-3 * steps, steps=steps, throw=False)
            return sol.xs, sol.result

        return jax.jit(jax.vmap(solve))

    runs = [_native(batch(tx.Native()), start), batch(tx.XLA())]
    timed = [Timed(functools.partial(run, start)) for run in runs]
    (ends, codes), (others, other_codes) = (each.result() for each in timed)
    if not (jnp.all(codes == tx.Result.SUCCESS) and jnp.all(other_codes == tx.Result.SUCCESS)):
        raise RuntimeError("not all reached the end")
    # NumPy's maximum hands on NaN; Python's loses it.
    apart = float(np.max([jnp.abs(ends[name] - others[name]).max() for name in ends]))
    in_turn(timed, Repeats(rounds, rounds))
    return ratio(*timed), apart


def _agreeing_ratio() -> float:
    found, apart = batch_ratio()
    agree(apart, 1e-11)
    return found


def angles(count: int) -> NDArray[np.float64]:
    """Angles of all sizes to 1e9 rad, and those nearest to multiples of a quarter turn, where most cancels."""
    mp, random = mpmath(), np.random.default_rng(1)
    sizes = random.choice([-1.0, 1.0], count) * 10.0 ** random.uniform(-9.0, 9.0, count)
    with mp.workdps(50):
        near = np.array([float(mp.pi * int(k) / 2) for k in random.integers(1, 600_000_000, count)])
    return np.concatenate([sizes, near, np.nextafter(near, 0.0)])


def units_off(x: NDArray[np.float64], backend: Backend, sine: Callable[[tx.Expr], tx.Expr] = tx.Sin) -> float:
    """The worst sine or cosine, in units in the last place, against 50 digits."""
    mp, (s, c) = mpmath(), (tx.State("s"), tx.State("c"))
    dynamics = tx.compile(tx.System(rates={s: sine(s), c: tx.Cos(c)}), backend=backend)
    run = jax.jit(jax.vmap(lambda a: dynamics(0.0, {"s": a, "c": a})))
    found = (_native(run, x) if isinstance(backend, tx.Native) else run)(jnp.asarray(x))
    errors = []
    with mp.workdps(50):
        for name, function in (("s", mp.sin), ("c", mp.cos)):
            for angle, own in zip(x.tolist(), np.asarray(found[name]).tolist(), strict=True):
                exact = function(mp.mpf(angle))
                errors.append(float(abs(own - exact)) / float(np.spacing(abs(float(exact)))))
    return float(np.max(errors))


def _last_places() -> float:
    _need_llvmlite()
    return units_off(angles(30_000), tx.Native())


KERNELS = Section(
    "kernels",
    "Native kernels",
    "What kernels take to build and to call, and whether they are right.",
    {
        "": [
            Check(
                "building the Panda's ABA",
                "llvmlite",
                lambda: _build_seconds(lambda: program_of(_PANDA)),
                at_most(0.4, "s"),
            ),
            Check(
                "building its Jacobian",
                "llvmlite",
                lambda: _build_seconds(lambda: one_by_one(_slopes(_PANDA))),
                at_most(4.0, "s"),
                slow=True,
            ),
            Check(
                "a call of it above one that adds its arguments", "llvmlite", _above_an_empty_call, at_most(1.0, "us")
            ),
            Check(
                "65,536 integrations of 1,000 RKMK4 steps, time over that of XLA's loop",
                "llvmlite",
                _agreeing_ratio,
                at_most(0.3),
                slow=True,
            ),
            Check(
                "sine and cosine of 90,000 angles up to 1e9 rad, worst",
                "llvmlite",
                _last_places,
                at_most(2.0, "ulp"),
                slow=True,
            ),
        ]
    },
)
