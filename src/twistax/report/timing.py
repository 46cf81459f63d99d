"""The one way to time: compiling apart, calls waited for, competitors in turn, medians."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Sequence
from statistics import median, quantiles
from typing import Any

import jax
import jax.numpy as jnp

from .rows import Row, Store

#: Called with what is going on, and how much of the present part is done, 0 to 1.
Tell = Callable[[str, float], None]
quiet: Tell = lambda what, share: None  # noqa: E731


def within(tell: Tell, place: int, count: int, before: str = "") -> Tell:
    """The same for one of some equal parts, with words before its own."""
    return lambda what, share: tell(f"{before}{what}", (place + share) / count)


#: Timed calls in a row on each visit, after one that is not timed; what is longer (s) is called once.
_CALLS, _SHORT = 3, 5e-3
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
        """Of a call; of a second one unless that takes long, as the first call of a program takes some ms more."""
        for _ in range(2):
            begin = time.perf_counter()
            found = jax.block_until_ready(self.call())
            self.rough = min(self.rough, time.perf_counter() - begin)
            if self.rough > _LONG:
                break
        return found

    @property
    def seconds(self) -> float:
        """The median."""
        return median(self.samples) / self.evaluations

    @property
    def numbers(self) -> dict[str, float]:
        """The quartiles, the fastest, and how many there are."""
        lower, _, upper = quantiles(self.samples, method="inclusive") if len(self.samples) > 1 else 3 * self.samples
        ends = {"lower": lower, "upper": upper, "fastest": min(self.samples)}
        return {name: value / self.evaluations for name, value in ends.items()} | {"repeats": float(len(self.samples))}


def compiled(function: Callable[..., Any], *arguments: Any, evaluations: int = 1, calls: int = 1) -> Timed:
    """A traceable function compiled for its arguments: so many evaluations in a call, and calls timed together."""
    begin = time.perf_counter()
    run = jax.jit(function)
    program = run.lower(*arguments).compile()
    seconds, needed = time.perf_counter() - begin, program.memory_analysis()
    memory = math.nan if needed is None else float(needed.temp_size_in_bytes)
    # Calls from Python find the jitted function faster than the compiled one.
    call = lambda: jax.block_until_ready(run(*arguments))  # noqa: E731
    return Timed(lambda: repeated(calls, call), calls * evaluations, seconds, memory)


def batch(function: Callable[..., Any], *points: Any) -> Timed:
    """A function of one point for many, their axis first: it writes where the call before wrote, as a loop in C does.

    What the system takes to give new memory is no part of its time. Compiling is the processor's time to the first
    result.
    """
    begin, points = time.process_time(), jax.tree.map(jnp.asarray, points)
    run = jax.jit(lambda *a: jax.vmap(function)(*a[:-1]), donate_argnums=len(points), keep_unused=True)
    shapes = jax.eval_shape(jax.vmap(function), *points)
    kept = [jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), shapes)]

    def call() -> Any:
        kept[0] = run(*points, kept[0])
        return kept[0]

    jax.block_until_ready(call())
    return Timed(call, len(jax.tree.leaves(points)[0]), time.process_time() - begin)


def repeated(count: int, call: Callable[..., Any], *arguments: Any) -> Any:
    """The result of the last of some calls."""
    for _ in range(count):
        result = call(*arguments)
    return result


def in_turn(timed: Sequence[Timed], repeats: Repeats, tell: Tell = quiet) -> None:
    """Take samples in rounds over all, so that whatever else the machine does falls on all alike.

    What takes long takes part in some of the rounds, evenly spread.
    """
    for each in timed:
        if math.isinf(each.rough):
            each.result()
    visits = [repeats.visits(each.rough) for each in timed]
    for number in range(repeats.rounds):
        tell("timing", 0.5 + 0.5 * number / repeats.rounds)
        for each, wanted in zip(timed, visits, strict=True):
            if (number + 1) * wanted // repeats.rounds > number * wanted // repeats.rounds:
                short = each.rough < _SHORT
                if short:
                    jax.block_until_ready(each.call())
                each.samples.extend(seconds_of(each.call) for _ in range(_CALLS if short else 1))


def keep(pairs: Sequence[tuple[Row, Timed | None]], repeats: Repeats, store: Store, tell: Tell = quiet) -> None:
    """Time those that are done in turn, but for what has samples already, and put all rows into the store."""
    timed = [(row, each if row.done else None) for row, each in pairs]
    in_turn([each for _, each in timed if each and not each.samples], repeats, tell)
    store.add(
        dataclasses.replace(row, value=each.seconds, numbers={**row.numbers, **each.numbers}) if each else row
        for row, each in timed
    )


def seconds_of(call: Callable[[], Any]) -> float:
    """Of one call, its results waited for."""
    begin = time.perf_counter()
    jax.block_until_ready(call())
    return time.perf_counter() - begin


def empty_call_seconds() -> float:
    """What calling a compiled function costs that does nothing: part of every time."""
    call = jax.jit(lambda x, setting: (x, setting))
    x, setting = {"R": jnp.eye(3), "w": jnp.ones(3)}, jnp.asarray(1.0)
    jax.block_until_ready(call(x, setting))
    return median(seconds_of(lambda: call(x, setting)) for _ in range(201))
