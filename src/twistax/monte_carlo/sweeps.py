"""Monte Carlo simulation: one function for many members, in chunks over all devices, resumable from disk, with failures
by member.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec
from numpy.typing import NDArray

from ..checks import callable_with, instance, path_of, reals, short, whole
from ..errors import InputError
from ..integrators import Result, Solution, ended_well
from ..progress import Progress
from .chunks import Chunks, Columns

__all__ = ["Statistics", "Sweep", "sweep"]


@dataclasses.dataclass(frozen=True)
class Statistics:
    """Mean, standard deviation and extremes of each result over all members that did not fail.

    Every array has the shape and the unit of the result of one member.

    Attributes:
        count: the number of members that did not fail.
        mean, std: the mean, and the sample standard deviation (divisor n - 1).
        least, most: the smallest and the largest value.
    """

    count: int
    mean: Any
    std: Any
    least: Any
    most: Any

    def __str__(self) -> str:
        """A line for each result."""
        lines = [f"{self.count} members"]
        columns = (jax.tree.leaves(moment) for moment in (self.mean, self.std, self.least, self.most))
        for (path, _), *values in zip(jax.tree_util.tree_leaves_with_path(self.mean), *columns, strict=True):
            texts = (np.array2string(np.asarray(value), precision=6) for value in values)
            words = ", ".join(map(" ".join, zip(("mean", "std", "least", "most"), texts, strict=True)))
            lines.append(f"{jax.tree_util.keystr(path, simple=True, separator='.') or 'result'}: {words}")
        return "\n".join(lines)


class Sweep:
    """The results of a sweep, which are read from its chunks when they are accessed.

    Attributes:
        count: the number of members.
        codes: (count,) the number of each member's `Result`.
        statistics: statistics over the members that did not fail.
    """

    def __init__(self, plan: _Plan, chunks: Chunks) -> None:
        self._plan, self._chunks = plan, chunks
        self.count = plan.count
        self.codes = np.concatenate([chunks.read(k)[-1] for k in range(plan.chunks)])
        self.statistics = _statistics(plan, chunks)

    def __repr__(self) -> str:
        return f"Sweep({self.count} members, {len(self.failed)} failed)"

    @property
    def failed(self) -> dict[int, Result]:
        """The numbers of the members that failed. `member` returns the inputs of one."""
        bad = np.flatnonzero(~ended_well(self.codes))
        return {int(i): Result(int(self.codes[i])) for i in bad}

    @functools.cached_property
    def values(self) -> Any:
        """The results of all members, including failed ones, on the leading axis; all in memory."""
        chunks = [self._chunks.read(k)[:-1] for k in range(self._plan.chunks)]
        return self._plan.tree([np.concatenate(parts) for parts in zip(*chunks, strict=True)])

    def percentiles(self, percent: float | int | Sequence[float | int]) -> Any:
        """Percentiles of each result over the members that did not fail, by linear interpolation; only one result is in
        memory at a time.

        Args:
            percent: from 0 to 100, one number or several, which become a leading axis.
        Raises:
            InputError: numbers outside of this range; every member failed.
        """
        percents = reals("percentiles", percent, InputError)
        if not np.all((percents >= 0.0) & (percents <= 100.0)):
            raise InputError(f"percentiles expects numbers from 0 to 100, got {percent}")
        good = ended_well(self.codes)
        if not good.any():
            raise InputError(
                f"percentiles expects at least one member that did not fail, but all {self.count} failed; "
                "see Sweep.failed"
            )

        def column(place: int) -> NDArray[Any]:
            return np.concatenate([self._chunks.read(k)[place] for k in range(self._plan.chunks)])[good].astype(float)

        return self._plan.tree([np.percentile(column(i), percents, axis=0) for i in range(self._plan.columns)])

    def member(self, number: int) -> Any:
        """The inputs of a member.

        Raises:
            InputError: the member does not exist.
        """
        if whole("member: number", number, 0) >= self.count:
            raise InputError(f"member expects a number from 0 to {self.count - 1}, got {number}")
        return self._plan.member(number)


def sweep(
    run: Callable[[Any], Any],
    members: Any,
    *,
    count: int | None = None,
    seed: int = 0,
    chunk: int = 4096,
    directory: str | os.PathLike[str] | None = None,
    devices: Sequence[jax.Device] | None = None,
    progress: bool | None = None,
) -> Sweep:
    """Run a function for many members, for example in a Monte Carlo simulation over initial states, parameters and
    controls.

        def drop(member):
            solution = tx.integrate(dynamics, member["x"], t1=10.0, dt=1e-3, params=member["params"])
            return solution, {"miss": jnp.linalg.norm(solution.xs["r"][-1])}

        found = tx.sweep(drop, lambda key: {"x": ..., "params": ...}, count=100_000, directory="out/drop")
        found.statistics.mean["miss"], found.percentiles([5, 50, 95])["miss"], found.failed

    Members are computed in chunks, and each chunk is distributed over the devices. With a directory, every complete
    chunk is stored: a repeated call resumes an interrupted one, and several processes of `jax.distributed` with the
    same directory share the chunks. A member that fails is listed by its number, with its `Result`, and does not affect
    the others.

    Args:
        run: a traceable function from one member to a `Solution`, to (Solution, results), or to results alone, a pytree
            of arrays. For a solution alone, the states at the saved times are stored. A member fails if its solution
            fails, or if a result is not finite.
        members: a pytree of arrays with members on the leading axis; or a traceable function from a random key to one
            member. The key depends only on `seed` and the member's number.
        count: the number of members, required if `members` is a function.
        chunk: the number of members in memory at a time, in each process.
        directory: the folder of the chunks, which is created if missing. None keeps them in memory.
        devices: devices of this process; None means all.
        progress: whether to show a line on the terminal; None: if there is a terminal.
    Raises:
        InputError: leading axes of different lengths, a missing or ambiguous count, several processes without a
            directory, a directory with another sweep.
    """
    usable = jax.local_devices() if devices is None else list(devices) if np.iterable(devices) else []
    local = {d for d in usable if isinstance(d, jax.Device) and d.process_index == jax.process_index()}
    if not usable or len(local) < len(usable):
        raise InputError(f"sweep: devices must be a list of different devices of this process, got {short(devices)}")
    plan = _Plan.of(run, members, count, seed, chunk, usable)
    if directory is None and jax.process_count() > 1:
        raise InputError("sweep in several processes requires a shared directory: sweep(..., directory=...)")
    instance("sweep: progress", progress, (bool, type(None)), "True, False or None", InputError)
    folder = None if directory is None else path_of("sweep", directory)
    chunks = Chunks(folder, plan.setup(), plan.chunks, plan.shapes_of, plan.compute)
    first = jax.process_index() == 0
    shown = sys.stderr.isatty() if progress is None else progress
    line = Progress("sweep", shown=first and shown)
    line.note("compiling and running the first chunk")
    of_process = range(jax.process_index(), plan.chunks, jax.process_count())
    missing = [k for k in of_process if k not in chunks]
    before = len(of_process) - len(missing)
    with line:
        for done, k in enumerate(missing, before + 1):
            chunks.keep(k, plan.compute(k))
            line.done(done / len(of_process), f"{plan.count} members", before / len(of_process))
        while not all(k in chunks for k in range(plan.chunks)):  # of other processes
            time.sleep(0.05)
    return Sweep(plan, chunks)


# ---- what is computed ------------------------------------------------------------------------------------------------


class _Plan:
    """The members, and the compiled function of a chunk of them."""

    def __init__(self, run: Any, draw: Any, arrays: Any, count: int, seed: int, size: int, devices: list[Any]) -> None:
        self._run, self._draw, self._arrays, self._seed = run, draw, arrays, seed
        self.count, self.size = count, min(size, count)
        self.chunks = -(-count // self.size)
        self._batch = -(-self.size // len(devices)) * len(devices)
        shape = jax.eval_shape(self._one, self._arguments(np.zeros(1, int), one=True))
        self._structure = jax.tree.structure(shape[0])
        self.shapes = [(leaf.shape, np.dtype(leaf.dtype).str) for leaf in jax.tree.leaves(shape[0])]
        self.columns = len(self.shapes)
        if not self.columns:
            raise InputError("sweep expects run to return a Solution or arrays, but it returns nothing")
        mapped = jax.vmap(self._one)
        if len(devices) > 1:
            shared = PartitionSpec("members")
            mesh = Mesh(np.array(devices), ("members",))
            # Unchecked, for the loops of users: these would have to say what varies between devices.
            mapped = jax.shard_map(mapped, mesh=mesh, in_specs=shared, out_specs=shared, check_vma=False)
        self._compiled = jax.jit(mapped)

    @classmethod
    def of(cls, run: Any, members: Any, count: int | None, seed: int, size: int, devices: list[Any]) -> _Plan:
        callable_with("sweep", run, ["member"], InputError)
        size, count = whole("sweep: chunk", size), None if count is None else whole("sweep: count", count)
        if (seed := whole("sweep: seed", seed, 0)) >= 2**32:
            raise InputError(f"sweep: seed must be less than 2^32, got {seed}")
        if callable(members):
            if count is None:
                raise InputError("sweep expects a count if members is a function: sweep(..., count=...)")
            callable_with("sweep: members", members, ["key"], InputError)
            drawn = jax.make_jaxpr(members)(jax.random.key(0)).jaxpr
            if drawn.invars[0] not in [*drawn.outvars, *(v for eqn in drawn.eqns for v in eqn.invars)]:
                raise InputError(
                    "sweep: members returns the same member for every key.\n"
                    "  fix: draw random numbers with the key, as jax.random.normal(key) does"
                )
            return cls(run, members, None, count, seed, size, devices)
        arrays = jax.tree.map(_as_jax_has_it, members)
        shapes = [np.shape(a) for a in jax.tree.leaves(arrays)]
        lengths = {shape[:1] for shape in shapes}
        if len(lengths) != 1 or lengths & {(), (0,)}:
            raise InputError(
                f"sweep expects arrays with one length of the leading axis, at least 1, got shapes {shapes}.\n"
                "  fix: pass arrays, np.array([...]); the entries of a list count as separate arrays"
            )
        ((length,),) = lengths
        if count is not None and count != length:
            raise InputError(f"sweep has arrays of {length} members, but count is {count}.\n  fix: leave count out")
        return cls(run, None, arrays, length, seed, size, devices)

    def tree(self, columns: Sequence[Any]) -> Any:
        """Columns as the results of a member are structured."""
        return jax.tree.unflatten(self._structure, columns)

    def member(self, number: int) -> Any:
        return self._member(self._arguments(np.array([number]), one=True))

    def compute(self, k: int) -> Columns:
        numbers = k * self.size + np.arange(self._batch)
        last = min(self.count, (k + 1) * self.size) - 1
        results, codes = self._compiled(self._arguments(np.minimum(numbers, last)))
        is_member = numbers <= last  # others fill up the batch
        return [np.asarray(column)[is_member] for column in (*jax.tree.leaves(results), codes)]

    def shapes_of(self, k: int) -> list[tuple[int, ...]]:
        rows = min(self.size, self.count - k * self.size)
        return [(rows, *shape) for shape, _ in [*self.shapes, ((), "")]]

    def setup(self) -> dict[str, Any]:
        """What says whether chunks on disk are of this sweep."""
        digest = hashlib.sha256()
        leaves, structure = jax.tree.flatten(self._arrays)
        digest.update(str(structure).encode())
        for leaf in leaves:
            digest.update(f"{leaf.shape} {leaf.dtype}".encode() + np.ascontiguousarray(leaf).tobytes())
        results = [str(self._structure), *([list(shape), dtype] for shape, dtype in self.shapes)]
        members = "drawn" if self._draw else digest.hexdigest()
        return {"count": self.count, "chunk": self.size, "seed": self._seed, "members": members, "results": results}

    def _arguments(self, numbers: NDArray[Any], one: bool = False) -> Any:
        """What the compiled function takes for members of these numbers; for one of them without an axis."""
        batch = numbers.astype(np.uint32) if self._draw else jax.tree.map(lambda a: a[numbers], self._arrays)
        return jax.tree.map(lambda a: a[0], batch) if one else batch

    def _member(self, argument: Any) -> Any:
        return self._draw(jax.random.fold_in(jax.random.key(self._seed), argument)) if self._draw else argument

    def _one(self, argument: Any) -> tuple[Any, jax.Array]:
        """The results of one member, and the number of its `Result`."""
        output, code = self._run(self._member(argument)), jnp.asarray(Result.SUCCESS.value, jnp.int32)
        pair = isinstance(output, tuple) and len(output) == 2 and isinstance(output[0], Solution)
        solution, results = output if pair else (output, output)
        if isinstance(solution, Solution):
            results, code = results if pair else solution.xs, jnp.asarray(solution.code, jnp.int32)
        is_solution = lambda part: isinstance(part, Solution)  # noqa: E731
        if any(map(is_solution, jax.tree.leaves(results, is_leaf=is_solution))):
            raise InputError(
                "sweep: run returns a Solution within its results, whose failure would not be detected.\n"
                "  fix: return (solution, results), or solution.xs of the others"
            )
        results = jax.tree.map(_as_numpy_has_it, results)
        real = [leaf for leaf in jax.tree.leaves(results) if jnp.issubdtype(leaf.dtype, jnp.inexact)]
        finite = functools.reduce(jnp.logical_and, [jnp.isfinite(leaf).all() for leaf in real], jnp.asarray(True))
        return results, jnp.where(ended_well(code) & ~finite, jnp.int32(Result.NON_FINITE.value), code)


def _as_numpy_has_it(value: Any) -> jax.Array:
    """An array in a type that NumPy keeps in files: float32 for bfloat16 and its like. Raises InputError."""
    array = jnp.asarray(value)
    if (array.dtype != bool and not jnp.issubdtype(array.dtype, np.number)) or jnp.iscomplexobj(array):
        raise InputError(
            f"sweep expects run to return real numbers, got {array.dtype}.\n"
            "  fix: return real and imaginary parts of complex numbers, and jax.random.key_data of keys"
        )
    return array.astype(jnp.float32) if array.dtype.kind == "V" else array


def _as_jax_has_it(value: Any) -> NDArray[Any]:
    """An array in the type that JAX gives it.

    Raises:
        InputError: entries are not numeric, or integers overflow, as without x64.
    """
    try:
        array = np.asarray(value)
    except TypeError:  # random keys, traced values
        array = np.empty(0, object)
    if array.dtype != bool and not jnp.issubdtype(array.dtype, np.number):
        raise InputError(
            f"sweep: members must be arrays of known numbers, got {short(value)}.\n"
            "  fix: for random keys pass a function of a key, and a count; call sweep outside of jit and vmap"
        )
    canonical = array.astype(jax.dtypes.canonicalize_dtype(array.dtype))
    if array.dtype.kind in "iu" and not np.array_equal(canonical, array):
        raise InputError(
            f"sweep has members that {canonical.dtype} cannot represent.\n"
            "  fix: use jax.config.update('jax_enable_x64', True)"
        )
    return canonical


# ---- statistics ------------------------------------------------------------------------------------------------------


@np.errstate(over="ignore")  # infinite then
def _statistics(plan: _Plan, chunks: Chunks) -> Statistics:
    """Of the members that did not fail, chunk by chunk: first sums and ends, then squared deviations from the mean."""

    def successes() -> Iterator[Columns]:
        for k in range(plan.chunks):
            *columns, codes = chunks.read(k)
            if (good := ended_well(codes)).any():
                yield [column[good] for column in columns]

    moments: list[tuple[Any, ...]] = []
    for columns in successes():
        new = [(len(a), a.sum(0, dtype=float), a.min(0), a.max(0)) for a in columns]
        moments = (
            [
                (n + m, total + more, np.minimum(least, low), np.maximum(most, high))
                for (n, total, least, most), (m, more, low, high) in zip(moments, new, strict=True)
            ]
            if moments
            else new
        )
    if not moments:
        nan = plan.tree([np.full(shape, np.nan) for shape, _ in plan.shapes])
        return Statistics(0, nan, nan, nan, nan)
    count = moments[0][0]
    means, squares = [total / count for _, total, *_ in moments], [0.0] * plan.columns
    for columns in successes():
        squares = [s + ((a - mean) ** 2).sum(0) for s, mean, a in zip(squares, means, columns, strict=True)]
    # Of one member there is no deviation.
    deviations = [np.sqrt(s / (count - 1 if count > 1 else np.nan)) for s in squares]
    least, most = ([moment[i] for moment in moments] for i in (2, 3))
    return Statistics(count, *map(plan.tree, (means, deviations, least, most)))
