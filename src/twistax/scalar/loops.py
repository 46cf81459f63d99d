"""Loops as primitives of JAX: a repeated step, and loops of JAX, with all iterations in one kernel."""

from __future__ import annotations

import dataclasses
import functools
import math
import weakref
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from ..jax_inside import Primitive, varying_alike, weakly_kept
from .jax_primitive import Computed, Shapes, by_kernel, define
from .program import Batch, Rows, ScalarProgram
from .small_call import need_outside
from .targets.xla import as_function

#: From the record of an iteration and a mark to a row.
Row: TypeAlias = Callable[[Any, jax.Array], jax.Array]

#: From whether it is for one batch member, and the platform, to a kernel; None: there is none.
MakeKernel: TypeAlias = Callable[[bool, str], "Rows | None"]

#: A table, and the number of the next row.
_Filled: TypeAlias = tuple[jax.Array, jax.Array]

#: In batches a member fills several rows at once: its number of rows divided by this,
_STEPS = 64
#: but at most this many, since rows that are not due yet are computed in vain.
_AT_ONCE = 16


class _Rolled(Computed):
    """A loop with the kernels of all its iterations. Compared and hashed by identity.

    Args:
        kernel: makes the kernel, for one member (True) or for many, on a platform; None where there is none.
    """

    def __init__(self, kernel: MakeKernel) -> None:
        self._kernel = functools.lru_cache(kernel)

    def kernel(self, rows: int, platform: str) -> Rows | None:
        return self._kernel(rows == 1, platform)


class Filling(NamedTuple):
    """Saved rows that are filled in order, each as soon as the loop has reached its mark.

    Attributes:
        marks: (n,) in order, n > 0, such as times; infinite for padding.
        table: (n, width) the rows.
        number: the index of the next row to fill.
    """

    marks: Any
    table: Any
    number: Any

    def up_to(self, reach: jax.Array, row: Row, record: Any) -> Filling:
        """Fill all rows whose marks are not beyond `reach`, each with row(record, mark).

        Args:
            row: reads nothing that is traced but its arguments.
        """
        return self.filled(*_filled(row)(reach, self, record))

    def filled(self, table: jax.Array, number: jax.Array) -> Filling:
        """The same marks with another table and the index of its next row."""
        return self._replace(table=table, number=number)


def _filled(row: Row) -> Callable[[jax.Array, Filling, Any], _Filled]:
    """A function that fills rows, from the progress so far and a record.

    Under vmap it is not the loop of one member with another axis: where some members have reached their marks and
    others have not, JAX would select between whole tables for every row.
    """

    @jax.custom_batching.custom_vmap
    def one(reach: jax.Array, rows: Filling, record: Any) -> _Filled:
        marks, count = rows.marks, len(rows.marks)

        def next_mark(number: jax.Array) -> jax.Array:
            return marks[jnp.minimum(number, count - 1)]

        def due(now: _Filled) -> jax.Array:
            return (now[1] < count) & (next_mark(now[1]) <= reach)

        def fill(now: _Filled) -> _Filled:
            table, number = now
            return table.at[number].set(row(record, next_mark(number))), number + 1

        return jax.lax.while_loop(due, fill, (rows.table, rows.number))

    @jax.custom_batching.custom_vmap
    def many(reach: jax.Array, rows: Filling, record: Any) -> _Filled:
        """The same for a batch, along the first axis of all arrays: some rows of each at once, while any is due."""
        count = rows.marks.shape[1]
        few = min(max(count // _STEPS, 1), _AT_ONCE)

        def due(now: _Filled) -> jax.Array:
            at = jnp.minimum(now[1], count - 1)
            marks = jnp.take_along_axis(rows.marks, at[:, None], 1)[:, 0]
            return ((now[1] < count) & (marks <= reach)).any()

        def fill(reach: jax.Array, marks: jax.Array, record: Any, table: jax.Array, number: jax.Array) -> _Filled:
            first = jnp.minimum(number, count - few)
            marks = jax.lax.dynamic_slice_in_dim(marks, first, few)
            here = (first + jnp.arange(few, dtype=number.dtype) >= number) & (marks <= reach)
            old = jax.lax.dynamic_slice_in_dim(table, first, few)
            new = jnp.where(here[:, None], jax.vmap(row, (None, 0))(record, marks), old)
            return jax.lax.dynamic_update_slice_in_dim(table, new, first, 0), number + here.sum(dtype=number.dtype)

        def fill_all(now: _Filled) -> _Filled:
            return jax.vmap(fill)(reach, rows.marks, record, *now)

        return jax.lax.while_loop(due, fill_all, (rows.table, rows.number))

    def with_batch_axis(size: int, mapped: Any, arguments: Any) -> Any:
        """All arguments broadcast to the batch axis."""
        return jax.tree.map(
            lambda batched, a: a if batched else jnp.broadcast_to(a, (size, *jnp.shape(a))), tuple(mapped), arguments
        )

    @one.def_vmap
    def of_one(size: int, mapped: Any, *arguments: Any) -> tuple[_Filled, tuple[bool, bool]]:
        return many(*with_batch_axis(size, mapped, arguments)), (True, True)

    @many.def_vmap
    def of_many(size: int, mapped: Any, *arguments: Any) -> tuple[_Filled, tuple[bool, bool]]:
        batched = with_batch_axis(size, mapped, arguments)
        shape = batched[0].shape
        results = many(*jax.tree.map(lambda a: a.reshape(math.prod(shape), *a.shape[2:]), batched))
        table, number = (a.reshape(*shape, *a.shape[1:]) for a in results)
        return (table, number), (True, True)

    return one


def decides(further: Sequence[Any]) -> bool:
    """Whether the results of a step, after its state, begin with a flag for another iteration, from their types."""
    return len(further) > 0 and further[0] == np.dtype(bool)


def _row_of(program: ScalarProgram) -> Row:
    function = as_function(program)
    return lambda record, mark: function(*record, mark)[0]


def repeating(step: Callable[..., Any], count: int, row: Row | None = None) -> Callable[..., list[jax.Array]]:
    """The loop of `repeat` over a step whose last `count` arguments are the state, as a function of JAX."""

    def loop(first: jax.Array, stop: jax.Array, *rest: jax.Array, rows: Filling | None = None) -> list[jax.Array]:
        fixed, state = rest[: len(rest) - count], rest[len(rest) - count :]

        def going(carried: tuple[jax.Array, jax.Array, Any]) -> jax.Array:
            return carried[1] & (carried[0] < stop)

        def iteration(carried: tuple[jax.Array, jax.Array, Any]) -> tuple[jax.Array, jax.Array, Any]:
            k, _, (state, rows) = carried
            results = step(k, *fixed, *state)
            new, record, good = results[:count], results[count:], jnp.asarray(True)
            if decides([a.dtype for a in record]):
                more, *record = record
            else:
                more = good = jnp.stack([jnp.isfinite(a).all() for a in new]).all()
                new = [jnp.where(good, after, before) for after, before in zip(new, state, strict=True)]
            if row is not None:
                least = -jnp.inf if jnp.issubdtype(record[0].dtype, jnp.floating) else jnp.iinfo(record[0].dtype).min
                rows = rows.up_to(jnp.where(good, record[0], least), row, record)
            return k + good.astype(k.dtype), more, (new, rows)

        start = (list(state), rows)
        k, _, (final, rows) = jax.lax.while_loop(going, iteration, (first, jnp.asarray(True), start))
        return [*final, k, *([] if rows is None else [rows.number, rows.table])]

    return loop


@weakly_kept
class Repeated(_Rolled):
    """A repeated step, and rows that are filled on the way.

    Args:
        step: takes (k, *fixed, *state), gives (*state); or (*state, more), more whether another iteration follows.
            With rows (reach, *record) follow.
        state: how many arguments are the state.
        kernel: as of all loops.
        row: takes (reach, *record, mark), gives a row; None: there are none.
        length: how many rows there are.
    """

    def __init__(
        self,
        step: ScalarProgram,
        state: int,
        kernel: MakeKernel,
        row: ScalarProgram | None = None,
        length: int = 0,
    ) -> None:
        super().__init__(kernel)
        self._step, self._state, self.row, self._length = step, state, row, length
        # Each number of rows is another program, which lives as long as the traces that use it.
        self._others: weakref.WeakValueDictionary[int, Repeated] = weakref.WeakValueDictionary()

    def of_length(self, length: int) -> Repeated:
        """The same loop for another number of rows, with the same kernels."""
        repeated = self._others.get(length)
        if repeated is None:
            repeated = self._others[length] = Repeated(self._step, self._state, self._kernel, self.row, length)
        return repeated

    def kernel(self, rows: int, platform: str) -> Rows | None:
        kernel = super().kernel(rows, platform)
        return kernel if kernel is None or self.row is None else functools.partial(kernel, length=self._length)

    @functools.cached_property
    def results(self) -> Shapes:
        number, *rest = [(a.shape, self._step.graph.dtype_of(a)) for a in self._step.inputs]
        results = [*rest[len(rest) - self._state :], number]
        if self.row is not None:
            results += [number, ((self._length, *self.row.outputs[0].shape), self.row.types[0])]
        return results

    @functools.cached_property
    def function(self) -> Callable[..., list[jax.Array]]:
        """The loop as a function of JAX."""
        row = None if self.row is None else _row_of(self.row)
        loop = repeating(as_function(self._step), self._state, row)
        if row is None:
            return loop

        def with_rows(
            _: jax.Array, first: jax.Array, stop: jax.Array, number: jax.Array, *rest: Any
        ) -> list[jax.Array]:
            *arguments, marks, table = rest
            return loop(first, stop, *arguments, rows=Filling(marks, table, number))

        return with_rows


@dataclasses.dataclass(frozen=True)
class Ring:
    """The map from results of an iteration to arguments of the next one.

    An iteration of a scan takes (*fixed, *state, *rows) and returns (*state, *rows), with rows of longer arrays. One of
    a `while_loop` takes (*fixed, *state) and returns (going, *state); where it is not going, the loop ends with the
    state before.

    Attributes:
        fixed, state: how many arguments stay the same, and how many are carried.
        length: the iterations of a scan; None: it is a `while_loop`.
        reverse: whether a scan begins with the last rows.
    """

    fixed: int
    state: int
    length: int | None = None
    reverse: bool = False


@weakly_kept
class Looped(_Rolled):
    """A loop of JAX.

    Args:
        function: of (count, *arguments).
        results: the shapes and types of its results.
        kernel: as of all loops.
    """

    def __init__(self, function: Callable[..., list[jax.Array]], results: Shapes, kernel: MakeKernel) -> None:
        super().__init__(kernel)
        self.function, self.results = function, results


#: A repeated step, or a loop.
_repeat_p = Primitive("repeated_step")
define(_repeat_p, by_kernel)


def repeat(
    step: Repeated | Looped,
    first: jax.Array,
    stop: jax.Array,
    fixed: Sequence[jax.Array],
    state: Sequence[jax.Array],
    rows: Filling | None = None,
) -> tuple[list[jax.Array], jax.Array, Filling | None]:
    """The loop state = step(k, fixed, state) for k = first, ..., stop - 1.

    A step with the result `more` may end the loop early. Other loops end where the new state is not finite, with the
    state before. Traceable, batched by vmap, not differentiable.

    Args:
        step: `Looped` where all arrays are those of `repeating`.
        rows: for a step that returns records.
    Returns:
        The state, the number of the next iteration, and the rows.
    """
    need_outside()
    arguments = [first, stop, *fixed, *state]
    if rows is not None:
        assert isinstance(step, Repeated)
        step = step.of_length(len(rows.marks))
        arguments = [jnp.int32(len(rows.marks)), first, stop, rows.number, *fixed, *state, rows.marks, rows.table]
    results = _repeat_p.bind(*varying_alike(arguments), program=step, batch=Batch(), inside=False)
    final, (k, *filled) = results[: len(state)], results[len(state) :]
    return final, k, None if rows is None else rows.filled(filled[1], filled[0])


def loop(looped: Looped, count: int, arguments: Sequence[Any]) -> list[jax.Array]:
    """The results of a loop. Traceable, batched by vmap, not differentiable."""
    return _repeat_p.bind(*varying_alike([jnp.int32(count), *arguments]), program=looped, batch=Batch(), inside=False)
