"""What is compiled goes when nothing uses it; several threads may compile and differentiate at once; Taylor series."""

from __future__ import annotations

import gc
import sys
import threading
import weakref
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from jax.experimental import jet

import twistax as tx

pytest.importorskip("llvmlite")

x, v = tx.State("x", shape=(3,)), tx.State("v", shape=(3,))
POINT = {"x": np.array([0.1, 0.2, 0.3]), "v": np.array([1.0, -0.5, 0.4])}


def _system(k: int) -> tx.System:
    J = np.diag([1.0, 2.0, 3.0 + k / 500])
    rate = tx.linalg.Solve(J, tx.linalg.Cross(v, J @ v) + (1.0 + k / 500) * x)
    for _ in range(4):
        rate = tx.linalg.Cross(rate, v) + tx.Sin(rate) * (k / 500 + 1.5)
    return tx.System({x: v, v: rate})


def _used(k: int) -> list[weakref.ref[Any]]:
    """A system compiled, called and differentiated, then dropped: its functions and its kernels."""
    from twistax.scalar.targets.llvm import kernel

    before = set(kernel._CODE)
    dynamics = tx.compile(_system(k), backend=tx.Native(least=0))
    jax.block_until_ready(dynamics(0.0, POINT))
    dynamics.jacobian(0.0, POINT)
    jax.grad(lambda x: dynamics(0.0, {**POINT, "x": x})["v"].sum())(POINT["x"])
    tx.integrate(dynamics, POINT, t0=0.0, t1=0.002, dt=0.001)
    made = [code for name, code in kernel._CODE.items() if name not in before]
    assert len(made) >= 3
    return [weakref.ref(dynamics.functions), *map(weakref.ref, made)]


def _own_memory() -> float:
    """MiB that this process has to itself. Pages of libraries come and go as the system likes."""
    status = Path("/proc/self/status").read_text()
    return int(status.split("RssAnon:")[1].split()[0]) / 2**10


@pytest.fixture(autouse=True)
def _new_objects_alone() -> Iterator[None]:
    """Objects of earlier tests, millions, are not looked through for what is garbage."""
    gc.freeze()
    yield
    gc.unfreeze()


def _left(refs: list[weakref.ref[Any]]) -> int:
    for _ in range(3):  # entries of caches go when their key does, and what only they held after that
        gc.collect()
    return sum(ref() is not None for ref in refs)


def test_kernels_go_with_what_they_were_compiled_for() -> None:
    refs = [ref for k in range(3) for ref in _used(k)]
    assert _left(refs) == 0
    # The same kernels again, under the names that XLA knows.
    refs = _used(0)
    assert _left(refs) == 0


def test_llvm_keeps_nothing_of_a_text(monkeypatch: pytest.MonkeyPatch) -> None:
    """In the context that all share, each number of each kernel would stay for as long as the process."""
    from llvmlite.binding import module

    from twistax.scalar.targets.llvm.machine_code import Processor, compiled

    monkeypatch.delattr(module, "get_global_context")
    assert compiled("define double @f() {\n ret double 0.125\n}", Processor.host())


def test_loops_of_fast_go_with_their_functions() -> None:
    from twistax.scalar.loops import Looped

    def used(k: int) -> None:
        def turned(a: jax.Array) -> jax.Array:
            matrix = jax.numpy.eye(3) * (1.0 + k / 1000)

            def body(c: jax.Array, _: Any) -> tuple[jax.Array, jax.Array]:
                c = jax.numpy.sin(matrix @ c) + jax.numpy.cross(c, a)
                return c, c

            return jax.lax.scan(body, a, None, length=100)[1]

        fast = tx.fast(turned)
        jax.block_until_ready((fast(np.ones(3)), jax.jit(fast)(np.ones(3))))

    def loops() -> list[weakref.ref[Any]]:
        return [weakref.ref(each) for each in gc.get_objects() if type(each) is Looped]

    used(0)
    refs = loops()
    assert refs
    assert _left(refs) == 0


def test_code_rests_before_it_goes(monkeypatch: pytest.MonkeyPatch) -> None:
    """A call that nobody waits for may still be under way when the last kernel goes."""
    from twistax.scalar.targets.llvm import kernel

    monkeypatch.setattr(kernel, "_RETIREMENT", 1e9)
    dynamics = tx.compile(_system(11), backend=tx.Native(least=0))
    before = set(map(id, kernel._CODE.values()))
    jax.block_until_ready(dynamics(0.0, POINT))
    codes = [weakref.ref(handle.code) for handle in kernel._CODE.values() if id(handle) not in before]
    del dynamics
    assert _left(codes) == len(codes) > 0
    monkeypatch.setattr(kernel, "_RETIREMENT", 0.0)
    kept = tx.compile(_system(12), backend=tx.Native(least=0))
    jax.block_until_ready(kept(0.0, POINT))
    assert _left(codes) == 0


def test_a_kernel_stays_while_something_compiled_calls_it() -> None:
    dynamics = tx.compile(_system(7), backend=tx.Native(least=0))
    expected = np.asarray(dynamics(0.0, POINT)["v"])
    compiled = jax.jit(lambda x: dynamics(0.0, {**POINT, "x": x})["v"]).lower(POINT["x"]).compile()
    del dynamics
    gc.collect()
    np.testing.assert_array_equal(np.asarray(compiled(POINT["x"])), expected)


@pytest.mark.parametrize("how", [{"dt": 0.001}, {"rtol": 1e-6, "dense": True}], ids=["fixed", "dense"])
def test_integrated_systems_go_without_a_word_to_jax(how: dict[str, Any]) -> None:
    dynamics = tx.compile(_system(8), backend=tx.Native(least=0))
    solution = tx.integrate(dynamics, POINT, t0=0.0, t1=0.002, **how)
    if "dense" in how:
        solution.evaluate(0.001)
    ref = weakref.ref(dynamics.functions)
    del dynamics, solution
    assert _left([ref]) == 0


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="no /proc")
def test_500_systems_leave_no_memory_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    """But for what was dropped within half a minute, which is as much as there was time to compile."""
    from twistax.scalar.targets.llvm import kernel

    monkeypatch.setattr(kernel, "_RETIREMENT", 0.0)
    _left([ref for k in range(10) for ref in _used(k)])
    before = _own_memory()
    for k in range(500):
        _used(k)
    assert _left([]) == 0
    assert _own_memory() - before < 50.0


def _at_once(function: Callable[[], Any], count: int = 8) -> list[Any]:
    """What a function gives in so many threads that start together and are interrupted often."""
    barrier, found, interval = threading.Barrier(count), [None] * count, sys.getswitchinterval()

    def run(k: int) -> None:
        barrier.wait()
        found[k] = function()

    threads = [threading.Thread(target=run, args=(k,)) for k in range(count)]
    sys.setswitchinterval(1e-6)
    try:
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    finally:
        sys.setswitchinterval(interval)
    return found


def test_threads_derive_one_program_as_one_thread_does() -> None:
    from twistax.scalar.derivatives import cotangent_program, tangent_program
    from twistax.scalar.program import ScalarProgram
    from twistax.scalar.reader import scalarize

    def made() -> ScalarProgram:
        f = tx.lower(_system(1).rates["v"])
        return scalarize(lambda x, v: [f(0.0, {"x": x, "v": v})], *POINT.values())

    def derivatives(program: ScalarProgram) -> list[Any]:
        arguments = [np.array([value]).reshape(-1) for value in POINT.values()]
        found = []
        for derived in (tangent_program(program, (0, 1)), cotangent_program(program, (0, 1))):
            own = [*arguments, *(np.ones(nodes.size) for nodes in derived.inputs[2:])]
            values = derived.computed(lambda k, j: own[k][j], lambda n, dtype: n, lambda o, i, *a: o.number(*a))  # noqa: B023
            found += [values[i] for i in derived.flat]
        return found

    alone, shared = derivatives(made()), made()
    for found in _at_once(lambda: derivatives(shared)):
        np.testing.assert_allclose(found, alone, rtol=1e-13)


class _Watched(list):
    """A list that asks, whenever it grows, whether another thread could take a lock."""

    def __init__(self, items: list[Any], lock: Any, other: Executor) -> None:
        super().__init__(items)
        self.lock, self.other, self.free = lock, other, set[bool]()

    def append(self, item: Any) -> None:
        self.free.add(self.other.submit(self._taken).result())
        super().append(item)

    def _taken(self) -> bool:
        taken: bool = self.lock.acquire(blocking=False)
        if taken:
            self.lock.release()
        return taken


@pytest.mark.parametrize("which", ["tangent_program", "cotangent_program", "contracted_program", "columns_of"])
def test_one_thread_at_a_time_adds_derivatives(which: str) -> None:
    """Two nodes that are added at once would get one number. No turn of threads is left to chance here."""
    from twistax.scalar import derivatives
    from twistax.scalar.primitives.interface import flat
    from twistax.scalar.reader import scalarize

    f = tx.lower(_system(1).rates["v"])
    program = scalarize(lambda x, v: [f(0.0, {"x": x, "v": v})], *POINT.values())
    graph, derivative = program.graph, getattr(derivatives, which)
    wanted = {flat(*program.inputs)[0]: {0: graph.one}} if which == "columns_of" else (0,)
    with ThreadPoolExecutor(1) as other:
        graph.nodes = watched = _Watched(graph.nodes, graph.lock, other)
        derivative(program, wanted)
    assert watched.free == {False}


def test_threads_compile_and_call_one_system() -> None:
    dynamics = tx.compile(_system(2), backend=tx.XLA(least=0))
    again = tx.compile(_system(2), backend=tx.XLA(least=0))

    def work() -> Any:
        slope = jax.grad(lambda x: dynamics(0.0, {**POINT, "x": x})["v"].sum())(POINT["x"])
        return np.concatenate([slope, dynamics.jacobian(0.0, POINT)["x"].reshape(-1)])

    expected = np.concatenate(
        [
            jax.grad(lambda x: again(0.0, {**POINT, "x": x})["v"].sum())(POINT["x"]),
            again.jacobian(0.0, POINT)["x"].reshape(-1),
        ]
    )
    for found in _at_once(work):
        np.testing.assert_allclose(found, expected, rtol=1e-12)


@pytest.mark.parametrize("backend", [tx.XLA(least=0), tx.Native(least=0)], ids=str)
def test_taylor_series_of_a_compiled_system(backend: Any) -> None:
    point, series = (np.ones(2),), ((np.array([1.0, 0.5]), np.array([0.2, 0.0]), np.zeros(2)),)
    y = tx.State("y", shape=(2,))
    dynamics = tx.compile(tx.System({y: tx.Sin(y) * y + tx.Exp(y)}), backend=backend)
    found = jet.jet(lambda v: dynamics(0.0, {"y": v})["y"], point, series)
    expected = jet.jet(lambda v: jax.numpy.sin(v) * v + jax.numpy.exp(v), point, series)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12)
