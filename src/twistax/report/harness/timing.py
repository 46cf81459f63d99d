"""Timing: compilation is timed separately, competitors are compared and then called in turn, calls are completed, and
medians are taken.
"""

import dataclasses
import functools
import math
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from statistics import median, quantiles
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .rows import ReportRow
from .store import Store

#: Called with what is going on, and how much of the present part is done, 0 to 1.
ProgressCallback = Callable[[str, float], None]
quiet: ProgressCallback = lambda what, share: None  # noqa: E731


def within(progress: ProgressCallback, place: int, count: int, before: str = "") -> ProgressCallback:
    """A progress callback for one of several equal parts, with words before its message."""
    return lambda what, share: progress(f"{before}{what}", (place + share) / count)


#: Timed calls in a row on each visit, after one that is not timed; what is longer (s) is called once.
_CALLS, _SHORT = 3, 5e-3
#: Points of a batch whose first call is timed as compilation.
_FEW = 64
#: What takes longer, s, is not called twice to see how long it takes.
_LONG = 0.1


@dataclasses.dataclass(frozen=True)
class Repeats:
    """How often calls are timed."""

    rounds: int = 15  # at most
    least: int = 5  # and at least, however long the call
    share: float = 2.0  # time for all repeats of one call, s; a longer one is repeated less often

    def visits(self, rough: float) -> int:
        """In how many rounds a call of so many seconds takes part."""
        visit = rough * (1 + _CALLS if rough < _SHORT else 1)
        return min(self.rounds, max(self.least, int(self.share / max(visit, 1e-9))))


@dataclasses.dataclass
class Timed:
    """What is called, and the samples of its time."""

    call: Callable[[], Any]  # gives arrays, waited for or to be waited for
    evaluations: int = 1  # in one call; times are of one evaluation
    compile_seconds: float = math.nan  # tracing and compiling
    memory: float = math.nan  # bytes that the program needs beside arguments and results
    rough: float = math.inf  # about how long a call takes, s: the shortest whose result was asked for
    samples: list[float] = dataclasses.field(default_factory=list)  # of a call, s

    def result(self) -> Any:
        """The result of a call; of a second one unless it takes long, as a program's first call takes some ms more."""
        for _ in range(2):
            begin = time.perf_counter()
            result = jax.block_until_ready(self.call())
            self.rough = min(self.rough, time.perf_counter() - begin)
            if self.rough > _LONG:
                break
        return result

    @property
    def seconds(self) -> float:
        """The median time of an evaluation."""
        return median(self.samples) / self.evaluations

    @property
    def numbers(self) -> dict[str, float]:
        """The quartiles, the fastest, and how many there are."""
        lower, _, upper = quantiles(self.samples, method="inclusive") if len(self.samples) > 1 else 3 * self.samples
        ends = {"lower": lower, "upper": upper, "fastest": min(self.samples)}
        return {name: value / self.evaluations for name, value in ends.items()} | {"repeats": float(len(self.samples))}


def compiled(function: Callable[..., Any], *arguments: Any, evaluations: int = 1, calls: int = 1) -> Timed:
    """Compile a traceable function for its arguments; `evaluations` happen in a call, `calls` are timed together."""
    begin = time.perf_counter()
    run = jax.jit(function)
    program = run.lower(*arguments).compile()
    seconds, analysis = time.perf_counter() - begin, program.memory_analysis()
    memory = math.nan if analysis is None else float(analysis.temp_size_in_bytes)
    # Calls from Python find the jitted function faster than the compiled one.
    call = lambda: jax.block_until_ready(run(*arguments))  # noqa: E731
    return Timed(lambda: repeated(calls, call), calls * evaluations, seconds, memory)


def batch(function: Callable[..., Any], *points: Any) -> Timed:
    """A function of one point for many, their axis first: it writes where the call before wrote, as a loop in C does.

    What the system takes to give new memory is no part of its time. Compiling is the processor's time to the first
    result of a few of the points, so that it contains neither the run time of all nor their memory.
    """
    begin, points = time.process_time(), jax.tree.map(jnp.asarray, points)
    jax.block_until_ready(jax.jit(jax.vmap(function))(*jax.tree.map(lambda a: a[:_FEW], points)))
    seconds = time.process_time() - begin
    run = jax.jit(lambda *a: jax.vmap(function)(*a[:-1]), donate_argnums=len(points), keep_unused=True)
    shapes = jax.eval_shape(jax.vmap(function), *points)
    memory = [jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), shapes)]

    def call() -> Any:
        memory[0] = run(*points, memory[0])
        return memory[0]

    jax.block_until_ready(call())
    return Timed(call, len(jax.tree.leaves(points)[0]), seconds)


def repeated(count: int, call: Callable[..., Any], *arguments: Any) -> Any:
    """The result of the last of some calls."""
    for _ in range(count):
        result = call(*arguments)
    return result


def in_turn(timed: Sequence[Timed], repeats: Repeats, progress: ProgressCallback = quiet) -> None:
    """Take samples in rounds over all, so that whatever else the machine does falls on all alike.

    What takes long takes part in some of the rounds, evenly spread.
    """
    for it in timed:
        if math.isinf(it.rough):
            it.result()
    visits = [repeats.visits(it.rough) for it in timed]
    for turn in range(repeats.rounds):
        progress("timing", 0.5 + 0.5 * turn / repeats.rounds)
        for it, wanted in zip(timed, visits, strict=True):
            if (turn + 1) * wanted // repeats.rounds > turn * wanted // repeats.rounds:
                short = it.rough < _SHORT
                if short:
                    jax.block_until_ready(it.call())
                it.samples.extend(seconds_of(it.call) for _ in range(_CALLS if short else 1))


def keep(
    pairs: Sequence[tuple[ReportRow, Timed | None]], repeats: Repeats, store: Store, progress: ProgressCallback = quiet
) -> None:
    """Time programs of rows in turn, but for those with samples already, and put all rows into the store."""
    timed = [(row, it if row.done else None) for row, it in pairs]
    in_turn([it for _, it in timed if it and not it.samples], repeats, progress)
    store.add(
        dataclasses.replace(row, value=it.seconds, numbers={**row.numbers, **it.numbers}) if it else row
        for row, it in timed
    )


def seconds_of(call: Callable[[], Any]) -> float:
    """Seconds of one call, its results waited for."""
    begin = time.perf_counter()
    jax.block_until_ready(call())
    return time.perf_counter() - begin


def empty_call_seconds() -> float:
    """Seconds of calling a compiled function that does nothing: part of every time."""
    call = jax.jit(lambda x, setting: (x, setting))
    x, setting = {"R": jnp.eye(3), "w": jnp.ones(3)}, jnp.asarray(1.0)
    jax.block_until_ready(call(x, setting))
    return median(seconds_of(lambda: call(x, setting)) for _ in range(201))


def printed(code: str, **environment: str) -> float:
    """The number that a program of Python prints in a process of its own."""
    options: dict[str, Any] = {"capture_output": True, "text": True, "check": True, "env": os.environ | environment}
    return float(subprocess.run([sys.executable, "-c", code], **options).stdout)


# ---- competitors -----------------------------------------------------------------------------------------------------


def agree(difference: float, bar: float) -> None:
    """Asked before times are compared. Raises RuntimeError where results differ by more than the bar, or by NaN."""
    if not difference <= bar:
        raise RuntimeError(f"DISAGREES by {difference:.1e}, more than {bar:.0e}")


def difference(results: Any, reference: Any) -> float:
    """The largest difference of an entry; NaN if there is one."""
    # NumPy's maximum propagates NaN; Python's does not.
    return float(np.max(jax.tree.leaves(jax.tree.map(lambda a, b: jnp.abs(a - b).max(), results, reference))))


class Race:
    """Several programs for one result: compared, then timed in turn, once, when one of their numbers is asked for.

    Args:
        make: gives the programs by name; the first is the reference. It may raise Absent.
        bar: the largest difference of a result from the reference with which times are compared.
        read: what is compared of a result.
    """

    def __init__(
        self,
        make: Callable[[], dict[str, Timed]],
        bar: float,
        repeats: Repeats = Repeats(7, 5),
        read: Callable[[Any], Any] = lambda result: result,
    ) -> None:
        self._make, self.bar, self._repeats, self.read = make, bar, repeats, read

    @functools.cached_property
    def programs(self) -> dict[str, Timed]:
        """The programs, timed in turn. Raises RuntimeError where results disagree."""
        programs = self._make()
        reference, *results = (self.read(it.result()) for it in programs.values())
        for result in results:
            agree(difference(result, reference), self.bar)
        in_turn(list(programs.values()), self._repeats)
        return programs

    def seconds(self, name: str, unit: float = 1.0) -> float:
        """The median time of an evaluation, in a unit in s."""
        return self.programs[name].seconds / unit

    def ratio(self, name: str, over: str) -> float:
        """The time of a program over that of another."""
        return self.seconds(name) / self.seconds(over)

    def compile_seconds(self, name: str) -> float:
        """What tracing and compiling took, s."""
        return self.programs[name].compile_seconds
