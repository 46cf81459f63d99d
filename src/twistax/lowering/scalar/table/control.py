"""Calls, loops and branches, and functions with a derivative of their own."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from ....jax_inside import ClosedJaxpr, closed, expansion, inner_jaxprs, scan_parts
from ..entry import ANY, Entry, Nodes, always_inside, each, entries, moving, one_of, takes
from .logic import LOGIC

if TYPE_CHECKING:
    from ..reader import Reader

__all__ = ["CONTROL"]

_V = np.array([0.5, -1.5])


# ---- calls -----------------------------------------------------------------------------------------------------------


def _jit(reader: Reader, eqn: Any, *arrays: Nodes) -> list[Nodes]:
    return reader.read(closed(eqn.params["jaxpr"]), arrays)


def _composite(reader: Reader, eqn: Any, *arrays: Nodes) -> list[Nodes] | None:
    """What it is composed of, where it has no derivative of its own."""
    inside = expansion(eqn, own_derivatives=False)
    return None if inside is None else reader.read(inside, arrays)


def _own(eqn: Any) -> ClosedJaxpr:
    """What a function with a derivative of its own does."""
    return closed(eqn.params["call_jaxpr"])


def _with_derivative(reader: Reader, eqn: Any, *arrays: Nodes) -> list[Nodes]:
    """A call, for its derivative; what is known needs none."""
    if reader.whole and not reader.known(arrays):
        return reader.call(eqn, arrays, _own(eqn))
    return reader.read(_own(eqn), arrays)


def _solve(reader: Reader, eqn: Any, *arrays: Nodes) -> list[Nodes]:
    """A linear solve is linear in its right-hand side: none is needed where the matrix is known."""
    counts, solve = eqn.params["const_lengths"], closed(eqn.params["jaxprs"].solve)
    if reader.whole and not reader.known(arrays[: sum(counts)]):
        return reader.call(eqn, arrays, solve)
    skip = counts.matvec + counts.vecmat
    return reader.read(solve, [*arrays[skip : skip + counts.solve], *arrays[sum(counts) :]])


def _doubled() -> Any:
    @jax.custom_jvp
    def function(x: jax.Array) -> jax.Array:
        return 2.0 * x

    function.defjvp(lambda p, t: (function(*p), 2.0 * t[0]))
    return function


def _doubled_back() -> Any:
    @jax.custom_vjp
    def function(x: jax.Array) -> jax.Array:
        return 2.0 * x

    function.defvjp(lambda x: (function(x), None), lambda _, c: (2.0 * c,))
    return function


# ---- loops and branches ----------------------------------------------------------------------------------------------


def _scan(reader: Reader, eqn: Any, *arrays: Nodes) -> list[Nodes] | None:
    p = eqn.params
    body, length = p["jaxpr"], p["length"]
    if length * _equations(body.jaxpr) > reader.graph.limits.equations:
        return None
    fixed, carried = scan_parts(eqn)
    consts, carry, along = arrays[:fixed], list(arrays[fixed : fixed + carried]), arrays[fixed + carried :]
    rows: list[list[Nodes]] = []
    for k in reversed(range(length)) if p["reverse"] else range(length):
        found = reader.read(body, [*consts, *carry, *(np.asarray(a[k]) for a in along)])
        carry = found[:carried]
        rows.append(found[carried:])
    if p["reverse"]:
        rows = rows[::-1]
    shapes = [v.aval.shape for v in eqn.outvars[carried:]]
    stacked = [np.array([row[i] for row in rows], np.int64).reshape(shape) for i, shape in enumerate(shapes)]
    return [*carry, *stacked]


def _cond(reader: Reader, eqn: Any, index: Nodes, *operands: Nodes) -> list[Nodes] | None:
    """The branch that is known, or all of them with the results selected."""
    branches, g = eqn.params["branches"], reader.graph
    number = g.numbers[int(index)]
    if number is not None:
        return reader.read(branches[int(np.clip(number, 0, len(branches) - 1))], operands)
    if sum(_equations(b.jaxpr) for b in branches) > g.limits.equations:
        return None
    before = len(g.calls)
    cases = [reader.read(branch, operands) for branch in branches]
    if not all(call.inline for call in g.calls[before:]):
        return None  # what is not unrolled runs only where its branch is taken: it may be a loop without end
    last = cases[-1]
    for k in range(len(branches) - 2, -1, -1):
        here = g.node(LOGIC["le"], int(index), g.constant(k, g.dtypes[int(index)]))
        last = [each(lambda a, b, here=here: g.select(here, a, b), x, y) for x, y in zip(cases[k], last, strict=True)]
    return last


def _equations(jaxpr: Any) -> int:
    """Equations, inner ones included."""
    return sum(1 + sum(_equations(inner.jaxpr) for inner in inner_jaxprs(eqn)) for eqn in jaxpr.eqns)


# ---- the entries -----------------------------------------------------------------------------------------------------

_SCAN = {"jaxpr": ANY, "length": ANY, "reverse": ANY, "unroll": ANY}
#: Where arrays of a jitted function lie, and how it is kept: nothing that changes numbers.
_WHERE = dict.fromkeys(
    str.split("in_shardings out_shardings in_layouts out_layouts ctx_mesh name inline keep_unused donated_invars"), ANY
)

CONTROL: dict[str, Entry] = entries(
    moving(
        name="jit",
        takes=(takes(jaxpr=ANY, compiler_options_kvs=lambda options: not options, **_WHERE),),
        read=_jit,
        example=(jax.jit(lambda a: 2.0 * a), _V),
    ),
    moving(
        name="remat2",
        takes=(takes(jaxpr=ANY, prevent_cse=ANY, differentiated=ANY, policy=ANY),),
        read=_jit,
        example=(jax.checkpoint(lambda a: 2.0 * jnp.sin(a)), _V),
    ),
    moving(
        name="call_hi_primitive",  # JAX 0.12
        takes=(takes(_prim=ANY),),
        read=_composite,
        example=(lambda a: jnp.searchsorted(a, a), _V),
    ),
    moving(
        name="custom_jvp_call",
        takes=(takes(call_jaxpr=ANY, jvp_jaxpr_fun=ANY, num_consts=ANY, symbolic_zeros=ANY),),
        read=_with_derivative,
        example=(_doubled(), _V),
    ),
    moving(
        name="custom_vjp_call",
        takes=(takes(call_jaxpr=ANY, fwd_jaxpr_thunk=ANY, bwd=ANY, num_consts=ANY, out_trees=ANY, symbolic_zeros=ANY),),
        read=_with_derivative,
        example=(_doubled_back(), _V),
    ),
    Entry(
        name="custom_linear_solve",
        takes=(takes(const_lengths=ANY, jaxprs=ANY),),
        read=_solve,
        any_type=True,
        inside=always_inside,  # as far as the equations in it are
        moves=True,
        runs=lambda eqn: [closed(eqn.params["jaxprs"].solve)],
        example=(lambda b: jnp.linalg.solve(jnp.array([[4.0, 1.0], [1.0, 3.0]]) + jnp.diag(b), b), _V),
    ),
    moving(
        name="scan",
        takes=(takes(**_SCAN, num_consts=ANY, num_carry=ANY), takes(**_SCAN, ft_in=ANY, ft_out=ANY)),  # 0.10; 0.11
        read=_scan,
        repeats=lambda eqn: eqn.params["length"],
        example=(lambda a: lax.scan(lambda c, row: (c + row, c * row), a[0], a), _V),
    ),
    moving(
        name="cond",
        takes=(takes(branches=ANY), takes(branches=ANY, branches_platforms=one_of())),  # by platform: not read
        read=_cond,
        example=(lambda a: lax.cond(a[0] > 0.0, jnp.sin, jnp.cos, a), _V),
    ),
    Entry(
        name="while",
        takes=(takes(body_jaxpr=ANY, body_nconsts=ANY, cond_jaxpr=ANY, cond_nconsts=ANY),),
        inside=always_inside,
        moves=True,
        example=(lambda a: lax.while_loop(lambda s: s[0] < 9.0, lambda s: 2.0 * s, a), _V),
    ),
    # This package's own.
    Entry(name="scalar_program", takes=(takes(derived=ANY, depth=ANY, inside=ANY),), inside=always_inside),
)
