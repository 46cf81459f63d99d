"""A function of arrays with loops and batches, in parts: straight-line parts as scalars, loops and batches as
kernels.
"""

from __future__ import annotations

import dataclasses
import functools
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...jax_inside import (
    ClosedJaxpr,
    Literal,
    Unread,
    closed,
    jaxpr_as_fun,
    parameters,
    scan_parts,
    weakly_kept,
)
from ..array_primitive import ArrayProgram
from ..backends import Backend, Emission, array_operations, operations_of, outweighs_memory, variables
from ..loops import Looped, Ring, loop
from ..primitives.table import say_unread
from ..program import Batch
from ..small_call import known_inside, small_call
from .inlining import inlined
from .members import BatchEquations
from .part import Constants, Part, Reason, is_loop, read_by, reason_of

#: Maps with more entries of arrays, all members together, stay loops if their arrays would be in memory at once.
_MOST_AT_ONCE = 10**8
#: Batches of fewer members are unrolled, or stay arrays.
_FEWEST = 4
#: Batches of more members are no rows of matrices.
_MOST_ROWS = 64
#: Programs of more operations take long to compile as scalars. They are batches of at least so many entries of arrays
#: where nearly all operations are entry by entry.
_LONG, _FEWEST_OF_LONG, _MOST_OF_LONG = 5000, 8, 0.95
#: Of the lengths of axes that arrays have, how many are tried as the length of a batch.
_TRIED = 4


@weakly_kept
class Segmented(ArrayProgram):
    """A function of arrays that is executed in parts. It is differentiated before it is split.

    Args:
        program: the function.
        backend: what runs its parts.
    """

    def __init__(self, program: ClosedJaxpr, backend: Backend) -> None:
        super().__init__(program)
        self.backend = backend

    @functools.cached_property
    def parts(self) -> tuple[Callable[..., list[jax.Array]], list[Reason]]:
        """The function for platforms with kernels, and a reason for each part."""
        return emit_segments(self.program, self.backend)

    def by_xla(self, arguments: Sequence[Any], batch: Batch, inside: bool, platform: str) -> list[jax.Array]:
        return batch.each(self.parts[0], arguments)

    def made(self, program: ClosedJaxpr) -> Segmented:
        return Segmented(program, self.backend)


# ---- segments --------------------------------------------------------------------------------------------------------


def has_parts(program: ClosedJaxpr, backend: Backend) -> bool:
    """Whether a function has loops that are not unrolled, or batches."""
    program = inlined(program, kernels=False)
    if any(map(is_loop, program.jaxpr.eqns)):
        return True
    batch = _batch(program, backend)
    return batch is not None and _instead(program, backend, batch) is None


def emit_segments(program: ClosedJaxpr, backend: Backend) -> tuple[Callable[..., list[jax.Array]], list[Reason]]:
    """The function that executes a jaxpr, and a reason for each of its parts."""
    program = inlined(program, kernels=False)
    jaxpr, has_loops, batch = program.jaxpr, any(map(is_loop, program.jaxpr.eqns)), _batch(program, backend)
    emission = None
    if not has_loops:
        emission = backend.emit(program) if batch is None else _instead(program, backend, batch)
    if emission is not None:
        return emission.function, [reason_of(emission)]
    parts = _parts(program, backend, batch)

    def run(*arguments: jax.Array) -> list[jax.Array]:
        values = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*program.consts, *arguments], strict=True))
        for step in parts:
            results = step.function(*(values[v] for v in step.inputs))
            values.update(zip(step.outputs, results, strict=True))
        return [jnp.asarray(v.val if isinstance(v, Literal) else values[v], v.aval.dtype) for v in jaxpr.outvars]

    return run, [reason for step in parts for reason in step.reasons]


#: The kinds of parts, in the order in which those run that wait for the same loops and batches.
_STRAIGHT, _BATCHED, _LOOPED = range(3)


def _parts(program: ClosedJaxpr, backend: Backend, batch: BatchEquations | None) -> list[Part]:
    """The parts in order: equations that wait for no loop or batch, loops and batches, what waits for these, and so
    on.
    """
    jaxpr, constants = program.jaxpr, Constants(program)
    made, members = set(map(id, constants.made)), {} if batch is None else batch.members
    after: dict[Any, int] = {}
    within: dict[Any, int] = {}  # for other equations of the batch
    groups: dict[tuple[int, int], list[Any]] = {}
    for eqn in jaxpr.eqns:
        if id(eqn) not in made:
            kind = _BATCHED if id(eqn) in members else _LOOPED if is_loop(eqn) else _STRAIGHT
            ranks = {**after, **within} if kind == _BATCHED else after
            rank = max((ranks.get(v, 0) for v in read_by([eqn])), default=0)
            groups.setdefault((rank, kind), []).append(eqn)
            after.update(dict.fromkeys(eqn.outvars, rank + (kind != _STRAIGHT)))
            within.update(dict.fromkeys(eqn.outvars if kind == _BATCHED else (), rank))
    wanted = dict.fromkeys(v for v in jaxpr.outvars if not isinstance(v, Literal))
    parts: list[Part] = []
    for (_, kind), eqns in sorted(groups.items(), key=lambda group: group[0], reverse=True):
        for chosen in [[eqn] for eqn in reversed(eqns)] if kind == _LOOPED else [eqns]:
            outputs = [v for eqn in chosen for v in eqn.outvars if v in wanted]
            if not outputs:
                continue
            if kind == _LOOPED:
                new = _loop(constants, chosen[0], backend)
            elif kind == _BATCHED and batch is not None:
                new = _batched(constants, chosen, outputs, backend, batch)
            else:
                new = _straight(constants, chosen, outputs, backend)
            parts.append(new)
            wanted.update(dict.fromkeys(new.inputs))
    # Results that are constants, and rows of constants that members of a batch read.
    parts.append(_straight(constants, [], [v for v in wanted if v in constants.known], backend))
    return parts[::-1]


def _straight(constants: Constants, eqns: Sequence[Any], outputs: Sequence[Any], backend: Backend) -> Part:
    program = constants.close(eqns, outputs)
    emission, computes = backend.emit(program), array_operations(program.jaxpr).total() > 0
    return Part(program.jaxpr.invars, outputs, emission.function, [reason_of(emission)] if computes else [])


# ---- batches ---------------------------------------------------------------------------------------------------------


def _batch(program: ClosedJaxpr, backend: Backend) -> BatchEquations | None:
    """The equations of the batch on which a function computes most; None where scalars or arrays suit it better."""
    if backend.widest is None:
        return None
    sizes, total, shortest = Counter[int](), operations_of(program.jaxpr.eqns).total(), _FEWEST
    arrays = [v.aval for v in variables(program.jaxpr) if v.aval.size > backend.widest]
    if not arrays and total > _LONG:
        arrays, shortest = [v.aval for v in variables(program.jaxpr)], _FEWEST_OF_LONG
    for aval in arrays:
        sizes.update({length: aval.size for length in aval.shape if length >= shortest})
    best, most = None, 0 if shortest == _FEWEST else _MOST_OF_LONG * total
    for size, _ in sizes.most_common(_TRIED):
        batch = BatchEquations(program.jaxpr, size)
        work = operations_of([eqn for eqn in program.jaxpr.eqns if id(eqn) in batch.members]).total()
        if work > most:
            best, most = batch, work
    return best if backend.least is not None and most >= backend.least else None


def _instead(program: ClosedJaxpr, backend: Backend, batch: BatchEquations) -> Emission | None:
    """What runs in place of a batch: its members may be the rows of matrices."""
    return backend.whole(program) if batch.size <= _MOST_ROWS else None


def _suits_batches(member: ClosedJaxpr, size: int, backend: Backend) -> bool:
    """Whether a map over members is to be a batch, which has what is computed of all of them in memory."""
    entries = size * sum(v.aval.size for v in variables(member.jaxpr))
    return size >= _FEWEST and backend.least is not None and outweighs_memory(member.jaxpr) and entries <= _MOST_AT_ONCE


def _batched(
    constants: Constants, eqns: Sequence[Any], outputs: Sequence[Any], backend: Backend, batch: BatchEquations
) -> Part:
    """The part of a batch: its members side by side."""
    member = batch.on_one(eqns, outputs)
    is_known = [axis is None and v in constants.known for v, axis in member.inputs]
    known = [v for (v, _), inside in zip(member.inputs, is_known, strict=True) if inside]
    inputs = [name for name, inside in zip(member.inputs, is_known, strict=True) if not inside]
    numbers, types = jaxpr_as_fun(constants.close([], known)), [v.aval.dtype for v in known]

    def one(*values: Any) -> list[Any]:
        constant, changing = iter(map(jnp.asarray, numbers(), types)), iter(values)
        return member.run(*(next(constant if inside else changing) for inside in is_known))

    shapes = []
    for v, axis in inputs:
        shape = [length for k, length in enumerate(v.aval.shape) if k != axis]
        shapes.append(jax.ShapeDtypeStruct(tuple(shape), v.aval.dtype))
    closed_member = jax.make_jaxpr(one)(*shapes)
    if not outweighs_memory(closed_member.jaxpr):
        return _straight(constants, eqns, outputs, backend)
    run, reasons = emit_segments(closed_member, backend)
    every = jax.vmap(run, [axis for _, axis in inputs], [0 if axis is None else axis for axis in member.results])

    def function(*values: Any) -> list[Any]:
        return [r if a is not None else r[0] for r, a in zip(every(*values), member.results, strict=True)]

    reasons = [reason.within(f"batch of {batch.size:,}") for reason in reasons]
    return Part([v for v, _ in inputs], outputs, function, reasons)


# ---- loops -----------------------------------------------------------------------------------------------------------


class _Operands:
    """The arguments of an equation: those that constants determine, and the others, its inputs."""

    def __init__(self, constants: Constants, eqn: Any) -> None:
        self.is_known = [isinstance(v, Literal) or v in constants.known for v in eqn.invars]
        self._known = [v for v, is_known in zip(eqn.invars, self.is_known, strict=True) if is_known]
        self.inputs = [v for v, is_known in zip(eqn.invars, self.is_known, strict=True) if not is_known]
        self._constants = constants

    def joined(self, values: Iterable[Any], count: int | None = None) -> list[Any]:
        """The first `count` arguments, from the values of those that are inputs."""
        is_known = self.is_known[:count]
        variables = self._known[: sum(is_known)]  # others, such as long rows, are not computed
        numbers = jaxpr_as_fun(self._constants.close([], variables))()
        known = (jnp.asarray(number, v.aval.dtype) for number, v in zip(numbers, variables, strict=True))
        inputs = iter(values)
        return [next(known if inside else inputs) for inside in is_known]


def _branches(operands: _Operands, eqn: Any, backend: Backend) -> Part:
    """A branch with loops in it."""
    branches = [emit_segments(closed(branch), backend) for branch in eqn.params["branches"]]

    def switched(*values: Any) -> Any:
        index, *arguments = operands.joined(values)
        return jax.lax.switch(index, [run for run, _ in branches], *arguments)

    all_reasons = [reason.within("branch") for _, reasons in branches for reason in reasons]
    return Part(operands.inputs, eqn.outvars, switched, all_reasons)


def _loop(constants: Constants, eqn: Any, backend: Backend) -> Part:
    """A loop, or a branch with loops in it."""
    name, operands = eqn.primitive.name, _Operands(constants, eqn)
    if name == "cond":
        return _branches(operands, eqn, backend)
    joined, inputs = operands.joined, operands.inputs

    def as_it_is(*values: Any) -> Any:
        return eqn.primitive.bind(*values, **eqn.params)

    try:
        ring, iteration = _iteration(eqn)
    except Unread as error:
        say_unread(error)
        return Part(
            inputs, eqn.outvars, lambda *values: as_it_is(*joined(values)), [Reason(f"{name}, executed by JAX", False)]
        )
    is_inside = operands.is_known[: ring.fixed]
    inner = dataclasses.replace(ring, fixed=is_inside.count(False))

    def step(*values: Any) -> list[jax.Array]:
        return iteration(*joined(values[: inner.fixed], ring.fixed), *values[inner.fixed :])

    def arguments(values: Sequence[Any]) -> list[Any]:
        """The arguments of the loop that are not known inside of it."""
        every = joined(values)
        return [*(a for a, inside in zip(every, is_inside, strict=False) if not inside), *every[ring.fixed :]]

    avals = [v.aval for v in eqn.invars]
    shapes = [jax.ShapeDtypeStruct(a.shape, a.dtype) for a, inside in zip(avals, is_inside, strict=False) if not inside]
    shapes += [jax.ShapeDtypeStruct(a.shape, a.dtype) for a in avals[ring.fixed : ring.fixed + ring.state]]
    shapes += [jax.ShapeDtypeStruct(a.shape[1:], a.dtype) for a in avals[ring.fixed + ring.state :]]
    inside = jax.make_jaxpr(step)(*shapes)
    if ring.length is not None and not ring.state and _suits_batches(inside, ring.length, backend):
        run, reasons = emit_segments(inside, backend)
        every = jax.vmap(run, [*[None] * inner.fixed, *[0] * (len(shapes) - inner.fixed)], axis_size=ring.length)
        reasons = [reason.within(f"batch of {ring.length:,}") for reason in reasons]
        return Part(inputs, eqn.outvars, lambda *values: every(*arguments(values)), reasons)
    # Loops inside of it that are not unrolled are kernels of their own.
    around = has_parts(inside, backend)
    kernel = None if around else backend.steps().looped(step, shapes, inner)
    if kernel is not None:
        results = [(v.aval.shape, np.dtype(v.aval.dtype)) for v in eqn.outvars]
        by_jax = lambda _, *a: as_it_is(*joined(a[: inner.fixed], ring.fixed), *a[inner.fixed :])  # noqa: E731
        looped = Looped(by_jax, results, kernel)
        reason = Reason(f"{name}: all iterations in one kernel", True)
        return Part(inputs, eqn.outvars, lambda *values: loop(looped, ring.length or -1, arguments(values)), [reason])
    program = constants.close([eqn], eqn.outvars)
    if ring.length is not None and not around and (emission := backend.whole(program)) is not None:
        return Part(program.jaxpr.invars, eqn.outvars, emission.function, [reason_of(emission).within(name)])
    small = known_inside(inside.jaxpr)  # as one small function a loop gains in any case
    if ring.length is None:
        ends_together = closed(eqn.params["cond_jaxpr"]).jaxpr.outvars[0].aval.size == 1
        opens = around and ends_together
        run, reasons = _while_around(eqn, backend) if opens else (as_it_is, [Reason(f"{name}, executed by JAX", small)])
        return Part(inputs, eqn.outvars, lambda *values: small_call(run, *joined(values)), reasons)
    body, reasons = emit_segments(inside, backend if around else backend.in_loops())
    run = functools.partial(_scanned, body, inner)
    reasons = [Reason(f"{name}: {reason.text}", reason.gains or small) for reason in reasons]
    return Part(inputs, eqn.outvars, lambda *values: small_call(run, *arguments(values)), reasons)


def _scanned(body: Callable[..., list[jax.Array]], ring: Ring, *values: Any) -> list[jax.Array]:
    """A loop as a scan of its compiled body."""
    constants, state, rows = values[: ring.fixed], values[ring.fixed :][: ring.state], values[ring.fixed + ring.state :]

    def iterate(state: Any, row: Any) -> tuple[Any, Any]:
        results = body(*constants, *state, *row)
        return results[: ring.state], results[ring.state :]

    carried, stacked = jax.lax.scan(iterate, list(state), list(rows), ring.length, ring.reverse)
    return [*carried, *stacked]


def _while_around(eqn: Any, backend: Backend) -> tuple[Callable[..., list[jax.Array]], list[Reason]]:
    """A `while_loop` that contains other loops, and the reasons of these."""
    asking = eqn.params["cond_nconsts"]
    fixed = asking + eqn.params["body_nconsts"]
    going, reasons_of_condition = emit_segments(closed(eqn.params["cond_jaxpr"]), backend)
    body, reasons_of_body = emit_segments(closed(eqn.params["body_jaxpr"]), backend)

    def run(*values: Any) -> list[jax.Array]:
        return jax.lax.while_loop(
            lambda state: going(*values[:asking], *state)[0].reshape(()),
            lambda state: body(*values[asking:fixed], *state),
            list(values[fixed:]),
        )

    return run, [reason.within("while") for reason in (*reasons_of_condition, *reasons_of_body)]


def _iteration(eqn: Any) -> tuple[Ring, Callable[..., list[Any]]]:
    """The order of a loop's values, and one iteration of it in that order.

    Raises:
        Unread: a loop of a later JAX.
    """
    p = eqn.params
    if eqn.primitive.name == "scan":
        fixed, carried = scan_parts(eqn)
        return Ring(fixed, carried, p["length"], p["reverse"]), jaxpr_as_fun(closed(p["jaxpr"]))
    p = parameters(eqn, {"body_jaxpr", "body_nconsts", "cond_jaxpr", "cond_nconsts"})
    asking, going = p["cond_nconsts"], jaxpr_as_fun(closed(p["cond_jaxpr"]))
    fixed, body = asking + p["body_nconsts"], jaxpr_as_fun(closed(p["body_jaxpr"]))

    def iteration(*values: Any) -> list[Any]:
        state = values[fixed:]
        return [*going(*values[:asking], *state), *body(*values[asking:fixed], *state)]

    return Ring(fixed, len(eqn.invars) - fixed), iteration
