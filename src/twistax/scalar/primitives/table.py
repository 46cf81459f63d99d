"""The table of primitives of JAX, which contains all information about a primitive for readers and writers.

A primitive without an entry, or with parameters that its entry does not know, remains a call of JAX, with the same
numbers. This file has the entries of calls, loops and branches, and of functions with custom derivatives.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ...jax_inside import Unread, all_equations, closed, expansion, scan_parts
from ...progress import say_once
from .arithmetic import CONTRACTION, ELEMENTWISE, LINEAR_ALGEBRA
from .entry import Entry, Read, moving
from .interface import Nodes, Reader, each, flat, kernel_of, nodes
from .movement import INDEXING, MOVEMENT
from .norms import NORM
from .operations import OPERATIONS, on
from .table_loads import TABLE_LOAD

# ---- calls -----------------------------------------------------------------------------------------------------------


def _jit(reader: Reader, eqn: Any, *arrays: Nodes) -> list[Nodes]:
    return reader.read(closed(eqn.params["jaxpr"]), arrays)


def _batched_by_rule(reader: Reader, eqn: Any, *arrays: Nodes) -> list[Nodes]:
    """A function with a batching rule, on one batch member."""
    return reader.read(closed(eqn.params["call"]), arrays)


def _composite(reader: Reader, eqn: Any, *arrays: Nodes) -> list[Nodes] | None:
    """What it is composed of, where it has no derivative of its own."""
    inside = expansion(eqn, own_derivatives=False)
    return None if inside is None else reader.read(inside, arrays)


def _with_derivative(reader: Reader, eqn: Any, *arrays: Nodes) -> list[Nodes]:
    """A call, for its derivative; what is known needs none."""
    body = closed(eqn.params["call_jaxpr"])
    return (
        reader.call(eqn, arrays, body) if reader.keeps_calls and not reader.known(arrays) else reader.read(body, arrays)
    )


def _solve(reader: Reader, eqn: Any, *arrays: Nodes) -> list[Nodes]:
    """A linear solve is linear in its right-hand side: none is needed where the matrix is known."""
    counts, solve = eqn.params["const_lengths"], closed(eqn.params["jaxprs"].solve)
    if reader.keeps_calls and not reader.known(arrays[: sum(counts)]):
        return reader.call(eqn, arrays, solve)
    skip = counts.matvec + counts.vecmat
    return reader.read(solve, [*arrays[skip : skip + counts.solve], *arrays[sum(counts) :]])


# ---- loops and branches ----------------------------------------------------------------------------------------------

#: What branches call the platforms with kernels.
_PLATFORMS = {"cpu", "cuda", "gpu"}


def _scan(reader: Reader, eqn: Any, *arrays: Nodes) -> list[Nodes] | None:
    p = eqn.params
    body, length = p["jaxpr"], p["length"]
    if length * _equations(body.jaxpr) > reader.graph.limits.equations:
        return None
    fixed, carried = scan_parts(eqn)
    consts, carry, inputs = arrays[:fixed], list(arrays[fixed : fixed + carried]), arrays[fixed + carried :]
    rows: list[list[Nodes]] = []
    before = len(reader.graph.calls)
    for k in reversed(range(length)) if p["reverse"] else range(length):
        if rows and not reader.keeps_calls and not all(c.inline or kernel_of(c) for c in reader.graph.calls[before:]):
            return None  # emitters with loops write it as one, with the calls inside
        results = reader.read(body, [*consts, *carry, *(np.asarray(a[k]) for a in inputs)])
        carry = results[:carried]
        rows.append(results[carried:])
    if p["reverse"]:
        rows = rows[::-1]
    shapes = [v.aval.shape for v in eqn.outvars[carried:]]
    stacked = [nodes(flat(*(row[i] for row in rows)), shape) for i, shape in enumerate(shapes)]
    return [*carry, *stacked]


def _cond(reader: Reader, eqn: Any, index: Nodes, *operands: Nodes) -> list[Nodes] | None:
    """The branch that is known, or all of them with the results selected."""
    branches, g = eqn.params["branches"], reader.graph
    number = g.numbers[int(index)]
    if number is not None:
        return reader.read(branches[int(np.clip(number, 0, len(branches) - 1))], operands)
    if "branches_platforms" in eqn.params:
        return None
    if sum(_equations(b.jaxpr) for b in branches) > g.limits.equations:
        return None
    before = len(g.calls)
    cases = [reader.read(branch, operands) for branch in branches]
    if not all(call.inline for call in g.calls[before:]):
        return None  # what is not unrolled runs only where its branch is taken: it may be a loop without end
    last = cases[-1]
    for k in range(len(branches) - 2, -1, -1):
        here = on(g, "le", int(index), g.constant(k, g.dtypes[int(index)]))
        last = [each(lambda a, b, here=here: g.select(here, a, b), x, y) for x, y in zip(cases[k], last, strict=True)]
    return last


def _platform_index(reader: Reader, eqn: Any) -> list[Nodes] | None:
    """The number of the branch of a platform. Kernels take that of all platforms, if no branch is for one of theirs."""
    platforms = eqn.params["platforms"]
    if None not in platforms or not _PLATFORMS.isdisjoint(name for names in platforms for name in names or ()):
        return None
    return [np.asarray(reader.graph.constant(platforms.index(None), np.dtype(np.int32)))]


def _equations(jaxpr: Any) -> int:
    return sum(1 for _ in all_equations(jaxpr))


def _of_one(read: Callable[[Reader, Any, Sequence[Nodes]], list[Nodes]]) -> Read:
    """The scalars of a program of this package, for one batch member: a batch of one is one too."""

    def scalars(reader: Reader, eqn: Any, *arrays: Nodes) -> list[Nodes] | None:
        depth, shared = eqn.params["batch"].depth, eqn.params["batch"].shared
        if _members(eqn) != 1:
            return None
        alone = [a if k in shared else a.reshape(a.shape[depth:]) for k, a in enumerate(arrays)]
        results = read(reader, eqn.params["program"].program, alone)
        return [a.reshape((*[1] * depth, *a.shape)) for a in results]

    return scalars


_alone = _of_one(lambda reader, program, arrays: reader.inlined(program, arrays))


def _program(reader: Reader, eqn: Any, *arrays: Nodes) -> list[Nodes] | None:
    """A program of one member, or of all of a batch that is written out."""
    batch, program = eqn.params["batch"], eqn.params["program"]
    if batch.depth != 1 or not program.written_out:
        return _alone(reader, eqn, *arrays)
    rows = _members(eqn)
    arguments = [np.broadcast_to(a, (rows, *a.shape)) if k in batch.shared else a for k, a in enumerate(arrays)]
    return reader.repeated(eqn, program.program, arguments)


_written_out = _of_one(lambda reader, program, arrays: reader.read(program, arrays))


def _function(reader: Reader, eqn: Any, *arrays: Nodes) -> list[Nodes] | None:
    """A function that runs in parts; one without derivatives stays a call, which kernels can make."""
    kernel = eqn.params["program"].inside_kernels
    stays = kernel is not None and reader.graph.limits.functions
    if not stays or eqn.params["batch"].depth or reader.known(arrays):
        return _written_out(reader, eqn, *arrays)
    return reader.call(eqn, arrays, key=kernel)


def _members(eqn: Any) -> int:
    """How many members the batch has."""
    return math.prod(eqn.outvars[0].aval.shape[: eqn.params["batch"].depth])


def _operations(eqn: Any) -> dict[str, int]:
    """Operations of all members of the batch."""
    counts: dict[str, int] = eqn.params["program"].program.counts()
    return {name: _members(eqn) * count for name, count in counts.items()}


# ---- the entries -----------------------------------------------------------------------------------------------------

#: Where arrays of a jitted function lie, and how it is kept: nothing that changes numbers.
WHERE = "in_shardings out_shardings in_layouts out_layouts ctx_mesh name inline keep_unused donated_invars"
_SCAN = "jaxpr length reverse unroll"

_CONTROL = [
    moving("jit", _jit, f"jaxpr compiler_options_kvs {WHERE}", when=lambda p: not p["compiler_options_kvs"]),
    moving("custom_vmap_call", _batched_by_rule, "call rule in_tree out_tree"),
    moving("remat2", _jit, "jaxpr prevent_cse differentiated policy"),
    moving("call_hi_primitive", _composite, "_prim"),  # JAX 0.12
    moving("custom_jvp_call", _with_derivative, "call_jaxpr jvp_jaxpr_fun num_consts symbolic_zeros"),
    moving("custom_vjp_call", _with_derivative, "call_jaxpr fwd_jaxpr_thunk bwd num_consts out_trees symbolic_zeros"),
    moving(
        "custom_linear_solve",  # inside as far as the equations in it are
        _solve,
        "const_lengths jaxprs",
        runs=lambda eqn: [closed(eqn.params["jaxprs"].solve)],
    ),
    moving(
        "scan",
        _scan,
        f"{_SCAN} num_consts num_carry | {_SCAN} ft_in ft_out",  # JAX 0.10; 0.11 and later
        repeats=lambda eqn: eqn.params["length"],
    ),
    moving("cond", _cond, "branches | branches branches_platforms"),
    moving("platform_index", _platform_index, "platforms"),
    moving("while", None, "body_jaxpr body_nconsts cond_jaxpr cond_nconsts"),
    # This package's own.
    TABLE_LOAD,
    NORM,
    moving("scalar_program", _program, "program batch inside", moves=False, work=_operations),
    Entry("native_program", _program, "program batch inside", any_type=True, work=_operations),
    moving(
        "batched_function",
        _function,
        "program batch inside",
        # A kernel is no part of a small function.
        inside=lambda eqn: not eqn.params["batch"].depth and not eqn.params["program"].exports_kernels,
        repeats=_members,
    ),
]

#: By the name of the primitive.
TABLE: dict[str, Entry] = {
    **OPERATIONS,
    **{e.name: e for e in (*ELEMENTWISE, *MOVEMENT, *INDEXING, *CONTRACTION, *LINEAR_ALGEBRA, *_CONTROL)},
}


def entry_of(eqn: Any) -> Entry | None:
    """The entry of an equation; None if there is none, or if it does not support all parameters.

    One warning for names of parameters that it does not know.
    """
    entry = TABLE.get(eqn.primitive.name)
    try:
        return entry if entry is not None and entry.understands(eqn) else None
    except Unread as error:
        say_unread(error)
        return None


def say_unread(error: Unread) -> None:
    """Log once that an operation remains a call of JAX."""
    say_once(f"{error}, which this twistax does not know: JAX executes this operation")
