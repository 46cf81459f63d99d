"""Rules for primitives with a scalar form: whether an equation keeps the members of a batch separate along an axis.

It does if each part of its results along that axis depends only on the same part of its operands. A rule returns the
axes of operands and results, and the parameters of the equation for an axis of length one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, TypeAlias

from ..primitives.arithmetic import ELEMENTWISE
from ..primitives.operations import OPERATIONS

#: The axis of the batch in each array of an equation; None: all members share the array.
Axes: TypeAlias = "list[int | None]"


class Mixed(Exception):
    """An equation combines members of a batch, or no rule states that it keeps them separate."""


#: rule(equation, length of the batch, known axes of the operands) -> axes of the operands, axes of the results, and
#: the parameters that change. Raises Mixed.
Rule: TypeAlias = "Callable[[Any, int, Axes], tuple[Axes, Axes, Mapping[str, Any]]]"


def length_of(v: Any, axis: int) -> int:
    shape = v.aval.shape
    return shape[axis] if 0 <= axis < len(shape) else -1


def of_length_one(shape: Sequence[int], axis: int) -> tuple[int, ...]:
    """A shape with length one along an axis."""
    return (*shape[:axis], 1, *shape[axis + 1 :])


def _only(axes: Iterable[int | None]) -> int:
    """The one axis that is known."""
    known = {axis for axis in axes if axis is not None}
    if len(known) != 1:
        raise Mixed
    return known.pop()


# ---- entry by entry, and moved ---------------------------------------------------------------------------------------


def _each(eqn: Any, size: int, axes: Axes) -> tuple[Axes, Axes, Mapping[str, Any]]:
    """Entry by entry; operands without axes, or with one of length one, are for all entries."""
    axis, rank = _only(axes), max(v.aval.ndim for v in eqn.outvars)
    if any(v.aval.ndim not in (0, rank) for v in eqn.invars):
        raise Mixed
    return [None if length_of(v, axis) in (-1, 1) else axis for v in eqn.invars], [axis] * len(eqn.outvars), {}


def _broadcast(eqn: Any, size: int, axes: Axes) -> tuple[Axes, Axes, Mapping[str, Any]]:
    axis = eqn.params["broadcast_dimensions"][_only(axes)]
    return axes, [axis], {"shape": of_length_one(eqn.params["shape"], axis)}


def _reshape(eqn: Any, size: int, axes: Axes) -> tuple[Axes, Axes, Mapping[str, Any]]:
    """The axis whose entries are as far apart as before."""
    axis, new = _only(axes), eqn.params["new_sizes"]
    before = math.prod(eqn.invars[0].aval.shape[:axis])
    places = [i for i, length in enumerate(new) if length == size and math.prod(new[:i]) == before]
    if len(eqn.invars) != 1 or eqn.params["dimensions"] is not None or not places:
        raise Mixed
    return axes, [places[0]], {"new_sizes": of_length_one(new, places[0])}


def _transpose(eqn: Any, size: int, axes: Axes) -> tuple[Axes, Axes, Mapping[str, Any]]:
    return axes, [eqn.params["permutation"].index(_only(axes))], {}


def _without(name: str, removes: bool = True) -> Rule:
    """What works along the axes of a parameter, and removes them or not; a member has none of them."""

    def rule(eqn: Any, size: int, axes: Axes) -> tuple[Axes, Axes, Mapping[str, Any]]:
        axis, reduced = _only(axes), eqn.params[name]
        reduced = tuple(map(int, reduced if isinstance(reduced, tuple) else (reduced,)))
        if axis in reduced:
            raise Mixed
        result = axis - sum(i < axis for i in reduced) if removes else axis
        return [axis for _ in eqn.invars], [result] * len(eqn.outvars), {}

    return rule


def _slice(eqn: Any, size: int, axes: Axes) -> tuple[Axes, Axes, Mapping[str, Any]]:
    """Of all members: the result is as long."""
    axis = _only(axes)
    return axes, [axis], {"limit_indices": of_length_one(eqn.params["limit_indices"], axis)}


def _split(eqn: Any, size: int, axes: Axes) -> tuple[Axes, Axes, Mapping[str, Any]]:
    axis = _only(axes)
    if eqn.params["axis"] == axis:
        raise Mixed
    return axes, [axis] * len(eqn.outvars), {}


def _stack(eqn: Any, size: int, axes: Axes) -> tuple[Axes, Axes, Mapping[str, Any]]:
    axis = _only(axes)
    return [axis for _ in eqn.invars], [axis + (axis >= eqn.params["axis"])], {}


def _pad(eqn: Any, size: int, axes: Axes) -> tuple[Axes, Axes, Mapping[str, Any]]:
    axis = axes[0]
    if axis is None or axes[1] is not None or any(eqn.params["padding_config"][axis]):
        raise Mixed
    return axes, [axis], {}


def _dynamic_slice(eqn: Any, size: int, axes: Axes) -> tuple[Axes, Axes, Mapping[str, Any]]:
    axis, sizes = axes[0], eqn.params["slice_sizes"]
    if axis is None or any(a is not None for a in axes[1:]) or sizes[axis] != size:
        raise Mixed
    return axes, [axis], {"slice_sizes": of_length_one(sizes, axis)}


def _dynamic_update_slice(eqn: Any, size: int, axes: Axes) -> tuple[Axes, Axes, Mapping[str, Any]]:
    axis = _only(axes[:2])
    if any(a is not None for a in axes[2:]):
        raise Mixed
    return [axis, axis, *axes[2:]], [axis], {}


def _gather(eqn: Any, size: int, axes: Axes) -> tuple[Axes, Axes, Mapping[str, Any]]:
    numbers, sizes = eqn.params["dimension_numbers"], eqn.params["slice_sizes"]
    axis, index_axis = axes
    outer = [i for i in range(eqn.outvars[0].aval.ndim) if i not in numbers.offset_dims]
    pairs = list(zip(numbers.operand_batching_dims, numbers.start_indices_batching_dims, strict=True))
    paired = [pair for pair in pairs if axis == pair[0] or index_axis == pair[1]]
    if paired:
        axis, index_axis = paired[0]
        return [axis, index_axis], [outer[index_axis]], {}
    if index_axis is not None:  # of a table that all members share
        if axis is not None or index_axis >= len(outer):
            raise Mixed
        return axes, [outer[index_axis]], {}
    dropped = {*numbers.collapsed_slice_dims, *numbers.operand_batching_dims}
    if axis in dropped or axis in numbers.start_index_map or axis is None or sizes[axis] != size:
        raise Mixed
    result = numbers.offset_dims[sum(i not in dropped for i in range(axis))]
    return axes, [result], {"slice_sizes": of_length_one(sizes, axis)}


def _scatter(eqn: Any, size: int, axes: Axes) -> tuple[Axes, Axes, Mapping[str, Any]]:
    """Of all members alike, at places that they share."""
    numbers, (axis, index_axis, updates) = eqn.params["dimension_numbers"], axes
    windows = [i for i in range(eqn.invars[0].aval.ndim) if i not in numbers.inserted_window_dims]
    if axis is None and updates in numbers.update_window_dims:
        axis = windows[numbers.update_window_dims.index(updates)]
    moved = axis in numbers.inserted_window_dims or axis in numbers.scatter_dims_to_operand_dims
    if index_axis is not None or axis is None or moved or numbers.operand_batching_dims:
        raise Mixed
    return [axis, None, numbers.update_window_dims[windows.index(axis)]], [axis], {}


# ---- products and factors --------------------------------------------------------------------------------------------


def _dot_general(eqn: Any, size: int, axes: Axes) -> tuple[Axes, Axes, Mapping[str, Any]]:
    """Along a batch axis of both, or along a free axis of one where all members share the other."""
    (contracted, batched) = eqn.params["dimension_numbers"]
    for place, pair in enumerate(zip(*batched, strict=True)):
        if axes[0] == pair[0] or axes[1] == pair[1]:
            return list(pair), [place], {}
    side = 0 if axes[0] is not None else 1
    axis = axes[side]
    if axis is None or axes[1 - side] is not None or axis in contracted[side]:
        raise Mixed
    free = [[i for i in range(v.aval.ndim) if i not in (*c, *b)] for v, c, b in zip(eqn.invars, contracted, batched)]
    place = len(batched[0]) + (len(free[0]) if side else 0) + free[side].index(axis)
    return axes, [place], {}


def _matrices(eqn: Any, size: int, axes: Axes) -> tuple[Axes, Axes, Mapping[str, Any]]:
    """Of stacks of matrices; the axes of a stack come first."""
    axis = _only(axes)
    if any(axis >= v.aval.ndim - 2 for v in eqn.invars):
        raise Mixed
    return [axis for _ in eqn.invars], [axis] * len(eqn.outvars), {}


def _triangular_solve(eqn: Any, size: int, axes: Axes) -> tuple[Axes, Axes, Mapping[str, Any]]:
    """Also of right-hand sides side by side, with one matrix for all members."""
    column = eqn.invars[1].aval.ndim - (1 if eqn.params["left_side"] else 2)
    return (axes, [column], {}) if axes == [None, column] else _matrices(eqn, size, axes)


def _permutation(eqn: Any, size: int, axes: Axes) -> tuple[Axes, Axes, Mapping[str, Any]]:
    axis = _only(axes)
    if axis >= eqn.invars[0].aval.ndim - 1:
        raise Mixed
    return axes, [axis], {}


def _program(eqn: Any, size: int, axes: Axes) -> tuple[Axes, Axes, Mapping[str, Any]]:
    """A program of this package on a batch."""
    axis, batch = _only(axes), eqn.params["batch"]
    if axis >= batch.depth:
        raise Mixed
    return [None if k in batch.shared else axis for k in range(len(axes))], [axis] * len(eqn.outvars), {}


_REDUCED = ("sum", "prod", "max", "min", "and", "or")
RULES: Mapping[str, Rule] = {
    **dict.fromkeys((entry.name for entry in (*OPERATIONS.values(), *ELEMENTWISE)), _each),
    "broadcast_in_dim": _broadcast,
    "reshape": _reshape,
    "transpose": _transpose,
    "squeeze": _without("dimensions"),
    "rev": _without("dimensions", removes=False),
    "concatenate": _without("dimension", removes=False),
    "slice": _slice,
    "split": _split,
    "stack": _stack,
    "unstack": _without("axis"),
    "pad": _pad,
    "dynamic_slice": _dynamic_slice,
    "dynamic_update_slice": _dynamic_update_slice,
    "gather": _gather,
    **dict.fromkeys(("scatter", "scatter-add"), _scatter),
    "dot_general": _dot_general,
    **dict.fromkeys((f"reduce_{name}" for name in _REDUCED), _without("axes")),
    **dict.fromkeys(("argmax", "argmin"), _without("axes")),
    **dict.fromkeys(("cumsum", "cumprod", "cummax", "cummin"), _without("axis", removes=False)),
    **dict.fromkeys(("cholesky", "lu"), _matrices),
    "triangular_solve": _triangular_solve,
    "lu_pivots_to_permutation": _permutation,
    **dict.fromkeys(("scalar_program", "native_program", "batched_function"), _program),
}
