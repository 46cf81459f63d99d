"""The rows of `python -m twistax report --gpu`, section by section, each run in a process of its own."""

from __future__ import annotations

import contextlib
import functools
import time
import traceback
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import jax
import numpy as np

import twistax as tx

from ...jax_inside import jax_versions
from ...scalar.targets.llvm import cuda_kernel
from ...scalar.targets.llvm.backend import KERNEL_EVENT
from ...scalar.targets.llvm.cuda import driver
from ...scalar.targets.llvm.ptx import libdevice
from ..sections import flights, problems
from . import cases

KERNELS, BY_XLA = tx.Native(), tx.XLA()
BATCH, LARGE = 65_536, 1_048_576
_TYPES = (np.float32, np.float64)


class Row(NamedTuple):
    """A measurement: what, by what, a number, its unit."""

    what: str
    by: str
    value: float
    unit: str


Rows = Iterator[Row]


def _tried(rows: Callable[[], Rows]) -> Rows:
    """Rows; where one fails its traceback is printed, and the rest is left out."""
    try:
        yield from rows()
    except Exception:
        traceback.print_exc()


def _placed(arguments: Any, platform: str) -> Any:
    return jax.device_put(arguments, jax.local_devices(backend=platform)[0])


def _seconds(function: Callable[..., Any], *arguments: Any, repeats: int = 10) -> tuple[float, float]:
    """Of the first call, and the least of those after it."""
    begin = time.perf_counter()
    jax.block_until_ready(function(*arguments))
    first, found = time.perf_counter() - begin, []
    for _ in range(repeats):
        begin = time.perf_counter()
        jax.block_until_ready(function(*arguments))
        found.append(time.perf_counter() - begin)
    return first, min(found)


def _difference(found: Any, expected: Any) -> float:
    """The largest, relative to the largest entry of each array."""
    worst = 0.0
    for own, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        a, b = np.asarray(own, float), np.asarray(other, float)
        if a.shape != b.shape or not np.array_equal(np.isfinite(a), np.isfinite(b)):
            return float("inf")
        worst = max(worst, float(np.max(np.abs(a - b)) / max(float(np.max(np.abs(b))), 1e-30)))
    return worst


# ---- values ----------------------------------------------------------------------------------------------------------


def machine() -> Rows:
    """The card, and whether a kernel runs there at all."""
    own, name = driver(), jax.devices("cuda")[0].device_kind
    print(f"card {name}, {own.capability}, CUDA {own.version}, JAX {jax_versions()}, {libdevice()}", flush=True)
    arguments = _placed(cases.joints(100, np.float32), "cuda")
    text = jax.jit(cases.accelerations(KERNELS)).lower(*arguments).as_text()
    yield Row("calls of kernels in a program", "", float(text.count("@twistax_")), "")


@contextlib.contextmanager
def _watched() -> Iterator[list[Any]]:
    """The kernels of devices that are made inside."""
    found: list[Any] = []
    made = cuda_kernel.CudaKernel.__init__

    def watched(self: Any, tile: Any) -> None:
        made(self, tile)
        found.append(self)

    cuda_kernel.CudaKernel.__init__ = watched  # type: ignore[method-assign]
    try:
        yield found
    finally:
        cuda_kernel.CudaKernel.__init__ = made  # type: ignore[method-assign]


def _functions() -> list[tuple[str, Any, Any]]:
    """What is compared, what makes it, and its arguments."""
    states: Any = lambda count, dtype: (cases.bodies(count, dtype),)  # noqa: E731
    return [
        ("ABA of the Panda", cases.accelerations, cases.joints),
        ("its Jacobian", cases.slopes, cases.joints),
        ("its gradient", cases.gradient, cases.joints),
        ("RKMK4, 1,000 steps", cases.rollout, states),
        ("adaptive, rtol 1e-5", cases.adaptive, states),
        ("adaptive, 11 rows saved", functools.partial(cases.adaptive, rows=11), states),
        ("a scan in one kernel", cases.walked, cases.joints),
        ("200 steps in a scan of XLA", cases.steps_in_scan, cases.joints),
    ]


def values() -> Rows:
    """Against the CPU."""
    for what, batch, inputs in _functions():
        for dtype in _TYPES:
            yield from _tried(functools.partial(_values, f"{what}, {np.dtype(dtype).name}", batch, inputs, dtype))


def _values(what: str, batch: Any, inputs: Any, dtype: Any) -> Rows:
    function, arguments = jax.jit(batch(KERNELS)), inputs(1000, dtype)
    expected = function(*_placed(arguments, "cpu"))
    given, begin = _placed(arguments, "cuda"), time.perf_counter()
    with _watched() as kernels:
        found = jax.block_until_ready(function(*given))
    took = time.perf_counter() - begin
    assert {own.platform for leaf in jax.tree.leaves(found) for own in leaf.devices()} == {"gpu"}
    yield Row(f"values, {what}", "kernels against the CPU", _difference(found, expected), "relative")
    yield Row(f"first call, {what}", f"{len(kernels)} kernels", took, "s")
    for each in kernels:
        code, kind = each.lease.code.device, f"{type(each.tile).__name__} of {each.tile.program.operations}"
        yield Row(f"registers, {what}", kind, float(code.registers), "")
        yield Row(f"local memory, {what}", kind, float(code.local), "bytes")


# ---- times -----------------------------------------------------------------------------------------------------------


def _timed(what: str, batch: Any, inputs: Any, by: Any, count: int, dtype: Any, steps: int = 1) -> Rows:
    """Nanoseconds for a body and step, and the seconds of the first call."""
    found: list[float] = []

    def heard(event: str, duration_secs: float, **_: Any) -> None:
        if event == KERNEL_EVENT:
            found.append(duration_secs)

    jax.monitoring.register_event_duration_secs_listener(heard)
    arguments = _placed(inputs(count, dtype), "cuda")
    first, best = _seconds(jax.jit(batch(by)), *arguments)
    name = f"{what}, {count:,}, {np.dtype(dtype).name}"
    how = "kernels" if isinstance(by, tx.Native) else "XLA"
    yield Row(name, how, best / count / steps * 1e9, "ns a body and step" if steps > 1 else "ns a body")
    yield Row(f"first call, {name}", how, first, "s")
    if found:
        yield Row(f"of it kernels, {name}", how, sum(found), "s")


def _states(count: int, dtype: Any) -> Any:
    return (cases.bodies(count, dtype),)


def rollouts() -> Rows:
    """RKMK4."""
    for dtype in _TYPES:
        for by, count in ((KERNELS, BATCH), (KERNELS, LARGE), (BY_XLA, BATCH)):
            run = functools.partial(_timed, "RKMK4", cases.rollout, _states, by, count, dtype, cases.STEPS)
            yield from _tried(run)


def arms() -> Rows:
    """The Panda."""
    for dtype in _TYPES:
        for by, count in ((KERNELS, BATCH), (KERNELS, LARGE), (BY_XLA, BATCH), (BY_XLA, LARGE)):
            yield from _tried(
                functools.partial(_timed, "ABA of the Panda", cases.accelerations, cases.joints, by, count, dtype)
            )
        yield from _tried(
            functools.partial(_timed, "Jacobian of it", cases.slopes, cases.joints, KERNELS, BATCH, dtype)
        )
        run = functools.partial(
            _timed, "200 steps in a scan", cases.steps_in_scan, cases.joints, KERNELS, BATCH, dtype, 200
        )
        yield from _tried(run)


def adaptive() -> Rows:
    """Rollouts to a tolerance."""
    for dtype in _TYPES:
        for by in (KERNELS, BY_XLA):
            yield from _tried(
                functools.partial(_timed, "adaptive, rtol 1e-5", cases.adaptive, _states, by, BATCH, dtype)
            )
    rows = functools.partial(cases.adaptive, rows=11)
    yield from _tried(functools.partial(_timed, "adaptive, 11 rows saved", rows, _states, KERNELS, BATCH, np.float32))


def blocks() -> Rows:
    """How many threads start together."""
    for block in (32, 64, 128, 256):
        cuda_kernel.BLOCK = block
        own = tx.Native(threads=block)  # another value: kernels of another size
        for dtype in _TYPES:
            for what, batch, inputs, steps in (
                ("ABA of the Panda", cases.accelerations, cases.joints, 1),
                ("RKMK4", cases.rollout, _states, cases.STEPS),
            ):
                run = functools.partial(_timed, what, batch, inputs, own, BATCH, dtype, steps)
                yield from (row._replace(by=f"blocks of {block}") for row in _tried(run) if row.unit.startswith("ns"))


# ---- beside a device -------------------------------------------------------------------------------------------------


def on_cpu() -> Rows:
    """Kernels of the CPU and the solver, with a device beside it or without."""
    by = "with a GPU" if any(own.platform == "gpu" for own in jax.devices()) else "without"
    with jax.default_device(jax.local_devices(backend="cpu")[0]):
        function, arguments = jax.jit(cases.rollout(KERNELS)), (cases.bodies(4096, np.float64),)
        _, best = _seconds(function, *arguments, repeats=5)
        yield Row("rollout on the CPU, 4,096", by, best / 4096 / cases.STEPS * 1e9, "ns a body and step")
        _, best = _seconds(jax.jit(cases.accelerations(KERNELS)), *cases.joints(4096, np.float64))
        yield Row("ABA on the CPU, 4,096", by, best / 4096 * 1e9, "ns a body")
    for what, make in (("cart-pole", problems.cart_pole), ("quadrotor", flights.quadrotor)):
        yield from _tried(functools.partial(_solved, what, make, by))


def _solved(what: str, make: Callable[[], Any], by: str) -> Rows:
    problem = make()
    first, best = _seconds(lambda: problem.solve().cost, repeats=5)
    yield Row(f"solve, {what}", by, best * 1e3, "ms")
    yield Row(f"first solve, {what}", by, first, "s")


#: By name, each with the most seconds that it may take.
SECTIONS: Mapping[str, tuple[Callable[[], Rows], float]] = {
    "machine": (machine, 60.0),
    "values": (values, 120.0),
    "rollouts": (rollouts, 90.0),
    "arms": (arms, 100.0),
    "with": (on_cpu, 60.0),
    "without": (on_cpu, 60.0),
    "adaptive": (adaptive, 100.0),
    "blocks": (blocks, 60.0),
}
