"""The rows of `python -m twistax report --gpu`, section by section, each measured in a separate process."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import os
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import jax
import numpy as np

import twistax as tx

from ...jax_inside import jax_versions
from ...scalar.targets.cuda import kernel as cuda_kernel
from ...scalar.targets.cuda.driver import driver
from ...scalar.targets.cuda.ptx import libdevice
from ...scalar.targets.llvm.backend import KERNEL_EVENT
from . import beside as beside_a_device
from . import cases
from .peers import PEERS

KERNELS, BY_XLA = tx.Native(), tx.XLA()
BATCH, LARGE = 65_536, 1_048_576
_TYPES = (np.float32, np.float64)
_LOOPS = ("fixed steps, 11 rows saved", "adaptive, up to an event")


@dataclasses.dataclass(frozen=True)
class Row:
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
    first, times = time.perf_counter() - begin, []
    for _ in range(repeats):
        begin = time.perf_counter()
        jax.block_until_ready(function(*arguments))
        times.append(time.perf_counter() - begin)
    return first, min(times)


def _difference(results: Any, expected: Any) -> float:
    worst = 0.0
    for result, other in zip(jax.tree.leaves(results), jax.tree.leaves(expected), strict=True):
        a, b = np.asarray(result, float), np.asarray(other, float)
        if a.shape != b.shape or not np.array_equal(np.isfinite(a), np.isfinite(b)):
            return float("inf")
        worst = max(worst, float(np.max(np.abs(a - b)) / max(float(np.max(np.abs(b))), 1e-30)))
    return worst


# ---- values ----------------------------------------------------------------------------------------------------------


def machine() -> Rows:
    """The card, and whether a kernel runs there at all."""
    cuda, name = driver(), jax.devices("cuda")[0].device_kind
    print(f"card {name}, {cuda.capability}, CUDA {cuda.version}, JAX {jax_versions()}, {libdevice()}", flush=True)
    arguments = _placed(cases.joints(100, np.float32), "cuda")
    text = jax.jit(cases.accelerations(KERNELS)).lower(*arguments).as_text()
    yield Row("calls of kernels in a program", "", float(text.count("@twistax_")), "")


@contextlib.contextmanager
def _watched() -> Iterator[list[Any]]:
    """The kernels of devices that are made inside."""
    kernels: list[Any] = []
    made = cuda_kernel.CudaKernel.__init__

    def watched(self: Any, body: Any) -> None:
        made(self, body)
        kernels.append(self)

    cuda_kernel.CudaKernel.__init__ = watched  # type: ignore[method-assign]
    try:
        yield kernels
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
        (
            "fixed steps, 11 rows saved",
            functools.partial(cases.rollout, dt=0.001, save_at=np.linspace(0, 1, 11)),
            states,
        ),
        ("adaptive, up to an event", cases.up_to_event, states),
        ("a scan in one kernel", cases.walked, cases.joints),
        ("200 steps in a scan of XLA", cases.steps_in_scan, cases.joints),
    ]


def values() -> Rows:
    """Against the CPU."""
    for what, batch, inputs in _functions():
        # Those of several loops compile for long.
        for dtype in _TYPES[what in _LOOPS :]:
            yield from _tried(functools.partial(_values, f"{what}, {np.dtype(dtype).name}", batch, inputs, dtype))


def _values(what: str, batch: Any, inputs: Any, dtype: Any) -> Rows:
    function, arguments = jax.jit(batch(KERNELS)), inputs(1000, dtype)
    expected = function(*_placed(arguments, "cpu"))
    placed = _placed(arguments, "cuda")
    with _watched() as kernels:
        _, results, first = _compiled(function, placed)
    assert {device.platform for leaf in jax.tree.leaves(results) for device in leaf.devices()} == {"gpu"}
    yield Row(f"values, {what}", "kernels against the CPU", _difference(results, expected), "relative")
    yield from first.rows(what, f"{len(kernels)} kernels compiled")
    for kernel in kernels:
        code, kind = kernel.handle.code.device, f"{type(kernel.body).__name__} of {kernel.body.program.operations}"
        yield Row(f"registers, {what}", kind, float(code.registers), "")
        yield Row(f"local memory, {what}", kind, float(code.local), "bytes")


# ---- times -----------------------------------------------------------------------------------------------------------


class _First(NamedTuple):
    """Seconds of the parts of a first call."""

    tracing: float  # by JAX
    lowering: float  # by JAX, kernels included
    kernels: float  # of these: written, compiled, checked, or read from the cache
    compiling: float  # by XLA
    running: float

    @property
    def all(self) -> float:
        return self.tracing + self.lowering + self.compiling + self.running

    def rows(self, what: str, by: str) -> Rows:
        yield Row(f"first call, {what}", by, self.all, "s")
        for name in ("tracing", "lowering", "kernels", "compiling"):
            yield Row(f"of it {name}, {what}", by, getattr(self, name), "s")


def _compiled(function: Any, arguments: Any) -> tuple[Any, Any, _First]:
    """What runs a function that is jitted, the first result, and what that took."""
    seconds: list[float] = []

    def heard(event: str, duration_secs: float, **_: Any) -> None:
        if event == KERNEL_EVENT:
            seconds.append(duration_secs)

    jax.monitoring.register_event_duration_secs_listener(heard)
    laps = [time.perf_counter()]

    def lap(value: Any) -> Any:
        laps.append(time.perf_counter())
        return value

    lowered = lap(lap(function.trace(*arguments)).lower())
    compiled = lap(lowered.compile())
    result = lap(jax.block_until_ready(compiled(*arguments)))
    tracing, lowering, compiling, running = np.diff(laps)
    return compiled, result, _First(tracing, lowering, sum(seconds), compiling, running)


def _timed(what: str, batch: Any, inputs: Any, by: Any, count: int, dtype: Any, steps: int = 1) -> Rows:
    """Nanoseconds for a body and step, and the seconds of the first call."""
    arguments = _placed(inputs(count, dtype), "cuda")
    compiled, _, first = _compiled(jax.jit(batch(by)), arguments)
    _, best = _seconds(compiled, *arguments)
    name = f"{what}, {count:,}, {np.dtype(dtype).name}"
    how = "kernels" if isinstance(by, tx.Native) else "XLA"
    yield Row(name, how, best / count / steps * 1e9, "ns a body and step" if steps > 1 else "ns a body")
    yield from first.rows(name, how)


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
    functions = {
        "ABA of the Panda": (cases.accelerations, 1),
        "100 calls in a jit": (cases.calls, 100),
        "Jacobian of it": (cases.slopes, 1),
        "200 steps in a scan": (cases.steps_in_scan, 200),
    }
    runs: list[tuple[str, Any, int]] = [("ABA of the Panda", KERNELS, BATCH), ("ABA of the Panda", KERNELS, LARGE)]
    runs += [("100 calls in a jit", KERNELS, BATCH), ("100 calls in a jit", KERNELS, LARGE)]
    runs += [("Jacobian of it", KERNELS, BATCH), ("200 steps in a scan", KERNELS, BATCH)]
    runs += [("ABA of the Panda", BY_XLA, BATCH), ("ABA of the Panda", BY_XLA, LARGE)]
    runs += [("200 steps in a scan", BY_XLA, BATCH)]
    for dtype in _TYPES:
        for what, by, count in runs:
            function, steps = functions[what]
            yield from _tried(functools.partial(_timed, what, function, cases.joints, by, count, dtype, steps))


def adaptive() -> Rows:
    """Rollouts to a tolerance."""
    rows = functools.partial(cases.adaptive, rows=11)
    for dtype in _TYPES:
        for by, what, batch in (
            (KERNELS, "adaptive, rtol 1e-5", cases.adaptive),
            (KERNELS, "adaptive, 11 rows saved", rows),
            (BY_XLA, "adaptive, rtol 1e-5", cases.adaptive),
            (BY_XLA, "adaptive, 11 rows saved", rows),
        ):
            if by is BY_XLA and batch is rows and dtype is np.float64:
                continue
            yield from _tried(functools.partial(_timed, what, batch, _states, by, BATCH, dtype))


def blocks() -> Rows:
    """Threads in a block."""
    for threads in (32, 64, 128, 256):
        cuda_kernel.BLOCK = threads
        backend = tx.Native(threads=threads)  # another value: other kernels
        for count in (BATCH, LARGE):
            run = functools.partial(
                _timed, "100 calls in a jit", cases.calls, cases.joints, backend, count, np.float32, 100
            )
            timed = (row for row in _tried(run) if row.unit.startswith("ns"))
            yield from (dataclasses.replace(row, by=f"{threads} threads") for row in timed)


# ---- beside others ---------------------------------------------------------------------------------------------------


def peers() -> Rows:
    """Other packages, with their values against those of kernels."""
    jax.config.update("jax_enable_x64", False)
    jax.config.update("jax_default_matmul_precision", "highest")  # else products of matrices have 10 bits
    function = jax.jit(cases.accelerations(KERNELS))
    for package, make in PEERS.items():
        try:
            name, batch = make()
        except ImportError as error:
            print(f"  {package}: not measured: {error}", flush=True)
            continue
        for count in (4096, BATCH):
            yield from _tried(functools.partial(_beside_peer, name, batch, function, count))


def _beside_peer(name: str, batch: Any, function: Any, count: int) -> Rows:
    arguments = _placed(cases.joints(count, np.float32), "cuda")
    compiled, result, first = _compiled(jax.jit(batch), arguments)
    yield Row(f"values, {count:,}", name, _difference(result, function(*arguments)), "relative to kernels")
    _, best = _seconds(compiled, *arguments)
    yield Row(f"ABA of the Panda, {count:,}, float32", name, best / count * 1e9, "ns a body")
    yield Row(f"first call, ABA of the Panda, {count:,}, float32", name, first.all, "s")


def beside() -> Rows:
    """Kernels of the CPU and the solver, with a device in the process or without."""
    yield from (Row(*row) for row in beside_a_device.measured())


# ---- what XLA does with them -----------------------------------------------------------------------------------------


def sharded() -> Rows:
    """A batch over a mesh of all devices of this process."""
    devices = jax.local_devices(backend="cuda")
    yield Row("devices in the mesh", "", float(len(devices)), "")
    mesh = jax.sharding.Mesh(np.array(devices), ("members",))
    spec = jax.sharding.PartitionSpec("members")
    for what, batch, arguments, steps in (
        ("ABA of the Panda", cases.accelerations(KERNELS), cases.joints(BATCH, np.float32), 1),
        ("RKMK4", cases.rollout(KERNELS), _states(BATCH, np.float32), cases.STEPS),
    ):
        expected = jax.jit(batch)(*_placed(arguments, "cuda"))
        placed = jax.device_put(arguments, jax.sharding.NamedSharding(mesh, spec))
        inside = jax.shard_map(batch, mesh=mesh, in_specs=spec, out_specs=spec)
        for how, function in (("shard_map", inside), ("jit, arrays that are distributed", batch)):
            compiled = jax.jit(function)
            result = compiled(*placed)
            yield Row(
                f"values, {what}, {BATCH:,}, float32", how, _difference(result, expected), "relative to one device"
            )
            _, best = _seconds(compiled, *placed)
            yield Row(f"{what}, {BATCH:,}, float32", how, best / BATCH / steps * 1e9, "ns a body")


def graphs() -> Rows:
    """Whether XLA starts kernels by CUDA graphs: what CUDA is called for, and times of short kernels."""
    flags = os.environ.get("XLA_FLAGS", "XLA's options")
    count = 256
    for what, batch, steps in (
        ("100 calls in a jit", cases.calls, 100),
        ("200 steps in a scan", cases.steps_in_scan, 200),
    ):
        arguments = _placed(cases.joints(count, np.float32), "cuda")
        compiled, _, _ = _compiled(jax.jit(batch(KERNELS)), arguments)
        _, best = _seconds(compiled, *arguments, repeats=30)
        yield Row(f"{what}, {count}, float32", flags, best / steps * 1e6, "us a step")
        with tempfile.TemporaryDirectory() as folder:
            with jax.profiler.trace(folder):
                jax.block_until_ready(compiled(*arguments))
            (file,) = Path(folder).rglob("*.xplane.pb")
            events = _events(file)
        for name in ("cuGraphLaunch", "cuLaunchKernel"):
            starts = sum(number for event, number in events.items() if event.startswith(name))
            yield Row(f"{what}, {count}, float32", f"{name}, {flags}", float(starts), "in a call")


def _events(file: Path) -> Counter[str]:
    """Events of a profile, by name."""
    profile = jax.profiler.ProfileData.from_file(str(file))
    return Counter(event.name for plane in profile.planes for line in plane.lines for event in line.events)


class Section(NamedTuple):
    """Rows, the most seconds that they may take, and variables of the environment of their process."""

    rows: Callable[[], Rows]
    seconds: float
    environment: Mapping[str, str] = MappingProxyType({})


_GRAPHS = "--xla_gpu_enable_command_buffer="

SECTIONS: Mapping[str, Section] = {
    "machine": Section(machine, 60.0),
    "values": Section(values, 120.0),
    "arms": Section(arms, 100.0),
    "adaptive": Section(adaptive, 100.0),
    "rollouts": Section(rollouts, 60.0),
    "peers": Section(peers, 60.0),
    "beside": Section(beside, 90.0),
    "sharded": Section(sharded, 30.0),
    "graphs": Section(graphs, 30.0),
    "graphs, none": Section(graphs, 30.0, {"XLA_FLAGS": _GRAPHS}),
    "graphs, loops too": Section(graphs, 30.0, {"XLA_FLAGS": f"{_GRAPHS}FUSION,CUBLAS,CUBLASLT,CUSTOM_CALL,WHILE"}),
    "blocks": Section(blocks, 60.0),
}
