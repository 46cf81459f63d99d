"""Kernels of the loop over steps, and of single steps for derivatives, for backends of the system that provide kernels.

Each kernel is compiled once for the structure and types of its inputs, and cached with the system; None if there is no
kernel.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Hashable
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from ...scalar.array_primitive import KernelOfArrays
from ...scalar.jax_primitive import Derived, Differentiable, call_program
from ...scalar.loops import Filling, Looped, Repeated, repeat
from ...scalar.small_call import inside_small_call, small_call
from ..charts.coordinates import Blocks
from ..method import Carry, StepAttempt, Stepper

Now = TypeVar("Now")
Result = TypeVar("Result")
Tree = TypeVar("Tree")

#: Larger states have no kernels: XLA vectorises over their entries.
_WIDEST = 400


@dataclasses.dataclass(frozen=True)
class _Unpacked:
    """Unpacks a flat array into a pytree."""

    structure: Any
    types: tuple[jax.ShapeDtypeStruct, ...]

    def __call__(self, flat: jax.Array) -> Any:
        ends = np.cumsum([0, *(shape.size for shape in self.types)])
        parts = [flat[a:b].reshape(shape.shape) for a, b, shape in zip(ends, ends[1:], self.types, strict=False)]
        leaves = [part.astype(shape.dtype) for part, shape in zip(parts, self.types, strict=True)]
        return jax.tree.unflatten(self.structure, leaves)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Packed:
    """A pytree packed in one array, because XLA would compile separate code for each of many scalars."""

    flat: Any  # an array; JAX rebuilds pytrees with stand-ins for arrays
    read: Callable[[jax.Array], Any] = dataclasses.field(metadata={"static": True})

    @classmethod
    def of(cls, tree: Any) -> Packed:
        return cls(*ravel_pytree(tree))

    def open(self) -> Any:
        """The pytree."""
        return self.read(self.flat)


def opened(tree: Any) -> Any:
    """The pytree, whether it is packed or not."""
    return tree.open() if isinstance(tree, Packed) else tree


def in_one(tree: Tree, dtype: Any) -> Any:
    """A pytree of numbers, small integers and booleans packed in one array; unchanged in small functions."""
    if inside_small_call():
        return tree
    leaves, structure = jax.tree.flatten(tree)
    flat = jnp.concatenate([jnp.asarray(leaf).reshape(-1).astype(dtype) for leaf in leaves])
    return Packed(flat, _Unpacked(structure, _types(leaves)))


def _made(stepper: Stepper, state: Any, key: Hashable, make: Callable[[], Any]) -> Any:
    """The kernel of a key from the cache of the system; None if the states are too wide."""
    if sum(jnp.size(leaf) for leaf in jax.tree.leaves(state)) > _WIDEST:
        return None
    return stepper.dynamics.functions.steps.get(key, make)


def _types(leaves: list[Any]) -> tuple[jax.ShapeDtypeStruct, ...]:
    return tuple(jax.ShapeDtypeStruct(jnp.shape(leaf), jnp.result_type(leaf)) for leaf in leaves)


class KernelSteps(NamedTuple):
    """Steps of fixed lengths of a method on a system, with inputs of some types, all in one call."""

    repeated: Repeated | Looped  # the step on flat arrays, the state in one
    evaluations: int  # of the right-hand side in a step

    def run(
        self,
        stepper: Stepper,
        grid: Any,
        first: jax.Array,
        stop: jax.Array,
        state: tuple[Blocks, Carry, Any],
        rows: Filling | None,
    ) -> tuple[tuple[Blocks, Carry, Any], jax.Array, Filling | None]:
        """Steps `first` to `stop` - 1, or until a state is not finite: the last finite state, the number of its step,
        and the saved rows.
        """
        packed = Packed.of(state)
        (flat,), count, filled = repeat(
            self.repeated, first, stop, jax.tree.leaves((grid, stepper)), [packed.flat], rows
        )
        return packed.read(flat), count, filled


def kernel_steps(
    stepper: Stepper, grid: Any, number: jax.Array, state: tuple[Blocks, Carry, Any], saves: bool = False
) -> KernelSteps | None:
    """Steps of a grid in one kernel; `number` is that of a step, for its type.

    Args:
        state: the stored state, what the method carries, and the slopes of the last step, where steps are sampled.
        saves: whether it fills rows with the states after some numbers of steps.
    """
    packed = Packed.of(state)
    leaves, structure = jax.tree.flatten((number, (grid, stepper)))
    of_state, form = jax.tree.flatten(state)
    types, parts = _types([*leaves, packed.flat]), _types(of_state)

    def make() -> KernelSteps | None:
        attempts: list[StepAttempt] = []

        def step(*leaves: jax.Array) -> list[jax.Array]:
            k, (grid, stepper) = jax.tree.unflatten(structure, leaves[:-1])
            state = packed.read(leaves[-1])
            attempts.append(grid.attempt(stepper.in_arrays, k, state))
            new = Packed.of((attempts[-1].y, attempts[-1].carry, state[2] and attempts[-1].slopes)).flat
            return [new, k + 1, Packed.of(attempts[-1].y).flat] if saves else [new]

        row = (lambda _, y, __: [y]) if saves else None
        repeated = stepper.dynamics.backend.steps().repeated(step, types, 1, row)
        # A kernel cannot report that the equations of a step were not solved.
        if repeated is None or attempts[-1].solved is not None or not isinstance(attempts[-1].evaluations, int):
            return None
        return KernelSteps(repeated, attempts[-1].evaluations)

    return _made(stepper, state[:2], (kernel_steps, structure, form, types, parts, saves), make)


def kernel_tries(
    one_try: Callable[[Any, Stepper, Now], tuple[Now, jax.Array, Any]],
    row: Callable[[Any, jax.Array], jax.Array],
    inputs: Any,
    stepper: Stepper,
    now: Now,
    state_of: Callable[[Now], Any] = lambda now: now,
) -> Callable[[Now, jax.Array, jax.Array, Filling | None], tuple[Now, Filling | None]] | None:
    """A loop over now = one_try(inputs, stepper, now) in one kernel.

    It takes the carry, the number of the first try, the stop, and the saved rows to fill, or None. Traceable, batched
    by vmap, not differentiable. Integers are represented by floating-point numbers.

    Args:
        one_try: also returns whether another try follows, and the record from which rows are computed, which begins
            with the time reached; None if the method has no rows. It depends only on the structure of its inputs.
        row: makes a row from the record of a try and a time up to that of the record.
        state_of: the part of the carry that must not be too wide for a kernel.
    """
    fixed, structure = jax.tree.flatten((inputs, stepper))
    state, form = jax.tree.flatten(now)
    types, kinds = _types([*fixed, *state]), [jnp.result_type(leaf) for leaf in state]
    dtype = next(kind for kind in kinds if jnp.issubdtype(kind, jnp.floating))

    def cast(leaves: Any) -> Now:
        return jax.tree.unflatten(form, [a.astype(kind) for a, kind in zip(leaves, kinds, strict=True)])

    def make() -> Any:
        records: list[Any] = []

        def iteration(_: jax.Array, *leaves: jax.Array) -> list[jax.Array]:
            inputs, stepper = jax.tree.unflatten(structure, leaves[: len(fixed)])
            now, more, record = one_try(inputs, stepper.in_arrays, cast(leaves[len(fixed) :]))
            records.append(jax.tree.structure(record))
            return [*(leaf.astype(dtype) for leaf in jax.tree.leaves(now)), more, *jax.tree.leaves(record)]

        def one_row(*leaves: jax.Array) -> list[jax.Array]:
            return [row(jax.tree.unflatten(records[-1], leaves[:-1]), leaves[-1])]

        shapes = [jax.ShapeDtypeStruct((), jnp.result_type(int)), *types[: len(fixed)]]
        shapes += [jax.ShapeDtypeStruct(shape.shape, dtype) for shape in types[len(fixed) :]]
        return stepper.dynamics.backend.steps().repeated(iteration, shapes, len(state), one_row)

    repeated: Repeated | None = _made(stepper, state_of(now), (kernel_tries, structure, form, types), make)
    if repeated is None:
        return None
    nothing = None
    if repeated.row is not None:
        width = repeated.row.outputs[0].size
        nothing = Filling(jnp.full(1, jnp.inf, dtype), jnp.zeros((1, width), dtype), jnp.zeros((), int))

    def run(now: Now, first: jax.Array, stop: jax.Array, rows: Filling | None) -> tuple[Now, Filling | None]:
        state = [jnp.asarray(leaf, dtype) for leaf in jax.tree.leaves(now)]
        results, _, filled = repeat(repeated, first, stop, fixed, state, nothing if rows is None else rows)
        return cast(results), None if rows is None else filled

    return run


def shared_kernel(function: Callable[..., Result], of: Any, stepper: Stepper, *rest: Any) -> Result:
    """function(of, stepper, *rest), outside of the kernel of a loop, as one kernel for all places that call it.

    XLA would compile it at each place. Without a kernel it is one small function.

    Args:
        function: hashable and traceable; it depends on the structure of its arguments alone.
    """
    if inside_small_call():
        return function(of, stepper, *rest)
    made = _shared_program(function, of, stepper, rest)
    if made is None:
        return small_call(function, of, stepper.outside_loops, *rest)
    program, shape = made
    return jax.tree.unflatten(shape, call_program(program, *jax.tree.leaves((of, stepper, rest))))


def has_shared_kernel(function: Callable[..., Any], of: Any, stepper: Stepper, *rest: Any) -> bool:
    """Whether `shared_kernel` calls a kernel."""
    return not inside_small_call() and _shared_program(function, of, stepper, rest) is not None


def _shared_program(function: Callable[..., Any], of: Any, stepper: Stepper, rest: Any) -> tuple[Derived, Any] | None:
    """The kernel of `shared_kernel`, and the structure of its results."""
    leaves, structure = jax.tree.flatten((of, stepper, rest))
    types = _types(leaves)

    def make() -> tuple[Derived, Any] | None:
        shapes: list[Any] = []

        def flat(*leaves: jax.Array) -> list[jax.Array]:
            of, stepper, rest = jax.tree.unflatten(structure, leaves)
            results, shape = jax.tree.flatten(function(of, stepper.in_arrays, *rest))
            shapes.append(shape)
            return results

        program = stepper.dynamics.backend.steps().shared(flat, types)
        return None if program is None else (program, shapes[-1])

    kernel: tuple[Derived, Any] | None = _made(stepper, rest, (shared_kernel, function, structure, types), make)
    return kernel


def advance_again(stepper: Stepper, t: jax.Array, y: Blocks, h: jax.Array) -> Blocks:
    """The method `advance` of a stepper for loops that are differentiated: it compiles faster as a program, and runs as
    one function.
    """
    program = _step_again(stepper, t, y, h)
    if program is None:
        return stepper.advance(t, y, h)
    return jax.tree.unflatten(jax.tree.structure(y), call_program(program, *jax.tree.leaves((stepper, t, y, h))))


def _step_again(stepper: Stepper, *arguments: Any) -> Differentiable | None:
    leaves, structure = jax.tree.flatten((stepper, *arguments))
    types = _types(leaves)

    def step(*leaves: jax.Array) -> list[jax.Array]:
        stepper, t, y, h = jax.tree.unflatten(structure, leaves)
        return jax.tree.leaves(stepper.in_arrays.advance(t, y, h))

    program: Differentiable | None = _made(
        stepper,
        arguments[1],
        (advance_again, structure, types),
        lambda: stepper.dynamics.backend.steps().differentiable(step, types),
    )
    return program


def scan_again(
    stepper: Stepper, y: Blocks, entries: tuple[jax.Array, Any], count: jax.Array, record: bool
) -> tuple[Blocks, Blocks | None] | None:
    """Several successive steps on matrices as one kernel, whose reverse pass is a kernel too; None if there is none.

    Args:
        entries: the numbers of the steps and their parts; those from `count` on change nothing.
        record: whether the values before each step are returned too.
    """
    first = jax.tree.map(lambda a: a[0], entries[1])
    if not isinstance(_step_again(stepper, first.t, y, first.h), KernelOfArrays):
        return None
    leaves, structure = jax.tree.flatten((stepper, y, entries, count))
    types = _types(leaves)

    def steps(*leaves: jax.Array) -> list[jax.Array]:
        stepper, y, entries, count = jax.tree.unflatten(structure, leaves)

        def one(y: Blocks, entry: tuple[jax.Array, Any]) -> tuple[Blocks, Blocks | None]:
            new = stepper.in_arrays.advance(entry[1].t, y, entry[1].h)
            return jax.tree.map(lambda a, b: jnp.where(entry[0] < count, a, b), new, y), y if record else None

        return jax.tree.leaves(jax.lax.scan(one, y, entries))

    key = (scan_again, structure, types, record)
    program = _made(stepper, y, key, lambda: stepper.dynamics.backend.steps().of_matrices(steps, types))
    if program is None:
        return None
    both: tuple[Blocks, Blocks | None] = (y, y if record else None)
    return jax.tree.unflatten(jax.tree.structure(both), call_program(program, *leaves))
