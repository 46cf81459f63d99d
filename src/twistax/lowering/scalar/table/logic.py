"""Comparisons, truth values, choices and conversions."""

from __future__ import annotations

import functools
import operator
from typing import TYPE_CHECKING, Any

import jax.numpy as jnp
import numpy as np
from jax import lax

from .. import in_c, in_casadi, in_llvm
from ..entry import ANY, Entry, Nodes, always_inside, each, entries, small_inside, takes
from ..operation import Convert, Forms, Operation, Select, everywhere

if TYPE_CHECKING:
    from ..graph import Graph
    from ..reader import Reader

__all__ = ["CHOICES", "LOGIC", "convert"]

_BOOL = np.dtype(bool)
_TRUTH, _REAL = np.array([True, False]), np.array([0.5, -1.5])


# ---- operations ------------------------------------------------------------------------------------------------------


def _greater(g: Graph, a: int, b: int) -> int:
    """Zero is greater than no magnitude: what is structurally zero never becomes a pivot."""
    known = a == g.zero and (operation := g.operation(b)) is not None and operation.name == "abs"
    return g.constant(False, _BOOL) if known else g.node(LOGIC["gt"], a, b)


def _comparison(name: str, sign: str, number: Any, array: Any, python: Any, maker: Any = None) -> Operation:
    """False where one is NaN, but for `ne`. Truth values have an order too."""
    equality = name in ("eq", "ne")
    real = "une" if name == "ne" else f"o{name}"
    signed, unsigned = (name, name) if equality else (f"s{name}", f"u{name}")
    return Operation(
        name=name,
        number=number,
        array=array,
        arity=2,
        result=_BOOL,
        symmetric=equality,
        maker=maker,
        llvm=Forms(*(in_llvm.instruction(i) for i in (f"fcmp {real}", f"icmp {signed}", f"icmp {unsigned}"))),
        c=everywhere(in_c.infix(sign)),
        casadi=everywhere(lambda casadi, a, b: python(a, b)),
    )


def _pair(name: str, absorbing: bool, g: Graph, a: int, b: int) -> int:
    """and, or: of truth values with what is known left out; of integers bit by bit."""
    for x, y in ((a, b), (b, a)) if g.dtypes[a] == _BOOL else ():
        known = g.numbers[x]
        if known is not None:
            return x if bool(known) is absorbing else y
    return a if a == b else g.node(LOGIC[name], a, b)


def _bits(name: str, number: Any, array: Any, signs: tuple[str, str], casadi: Any, maker: Any = None) -> Operation:
    """Of truth values, or of integers bit by bit; `signs` are those of C. CasADi has no bits of integers."""
    instruction = in_llvm.instruction(name)
    return Operation(
        name=name,
        number=number,
        array=array,
        arity=2,
        symmetric=True,
        maker=maker,
        example=(array, _TRUTH, _TRUTH[::-1]),
        llvm=Forms(None, instruction, instruction),
        c=Forms(None, in_c.bits(signs[0]), in_c.infix(signs[1])),
        casadi=Forms(None, None, casadi),
    )


LOGIC: dict[str, Operation] = {
    operation.name: operation
    for operation in [
        _comparison("eq", "==", np.equal, lax.eq, operator.eq),
        _comparison("ne", "!=", np.not_equal, lax.ne, operator.ne),
        _comparison("lt", "<", np.less, lax.lt, operator.lt),
        _comparison("le", "<=", np.less_equal, lax.le, operator.le),
        _comparison("gt", ">", np.greater, lax.gt, operator.gt, lambda g: functools.partial(_greater, g)),
        _comparison("ge", ">=", np.greater_equal, lax.ge, operator.ge),
        Operation(
            name="is_finite",
            number=np.isfinite,
            array=lax.is_finite,
            result=_BOOL,
            llvm=Forms(in_llvm.finite),
            c=Forms(in_c.finite),
            casadi=everywhere(lambda casadi, a: casadi.fabs(a) < np.inf),
        ),
        _bits(
            "and",
            np.bitwise_and,
            lax.bitwise_and,
            ("&", "&&"),
            lambda casadi, a, b: casadi.logic_and(a, b),
            lambda g: functools.partial(_pair, "and", False, g),
        ),
        _bits(
            "or",
            np.bitwise_or,
            lax.bitwise_or,
            ("|", "||"),
            lambda casadi, a, b: casadi.logic_or(a, b),
            lambda g: functools.partial(_pair, "or", True, g),
        ),
        _bits("xor", np.bitwise_xor, lax.bitwise_xor, ("^", "!="), lambda casadi, a, b: a != b),
        Operation(
            name="not",
            number=np.invert,
            array=lax.bitwise_not,
            example=(lax.bitwise_not, _TRUTH),
            llvm=Forms(None, in_llvm.not_of(-1), in_llvm.not_of(True)),
            c=Forms(None, lambda c, a: in_c.Written(f"({c.name})(~{a})"), in_c.prefix("!")),
            casadi=Forms(None, None, lambda casadi, a: casadi.logic_not(a)),
        ),
        Operation(
            name="stop_gradient",
            number=np.positive,
            array=lambda x: x,
            maker=lambda g: lambda x: x if g.numbers[x] is not None else g.node(LOGIC["stop_gradient"], x),
            example=(lax.stop_gradient, _REAL),
            moves=True,
            llvm=everywhere(in_llvm.same),
            c=everywhere(in_c.same),
            # Where JAX stops, a rule of its own takes over; CasADi differentiates what the rule stands for.
            casadi=everywhere(in_casadi.same),
        ),
        Select(
            name="select",  # JAX's own, of many cases, is `select_n`
            takes=(),
            number=np.where,
            array=lambda c, a, b: lax.select(c, a, b),
            arity=3,
            maker=lambda g: g.select,
            llvm=everywhere(in_llvm.selected),
            c=everywhere(in_c.selected),
            casadi=everywhere(lambda casadi, c, a, b: casadi.if_else(c, a, b)),
        ),
    ]
}


@functools.cache
def convert(dtype: np.dtype[Any]) -> Operation:
    """The conversion to a type."""
    return Convert(
        name=f"to {dtype.name}",
        takes=(),
        number=lambda x: (x if np.issubdtype(dtype, np.complexfloating) else np.real(x)).astype(dtype),
        array=lambda x: lax.convert_element_type(x, dtype),
        result=dtype,
        of=convert,
        llvm=in_llvm.converted(dtype),
        c=in_c.converted(dtype),
        casadi=in_casadi.converted(dtype),
    )


# ---- primitives made of them -----------------------------------------------------------------------------------------


def _select_n(reader: Reader, eqn: Any, which: Nodes, *cases: Nodes) -> list[Nodes]:
    """Case by case; a truth value chooses the second case where it holds."""
    g = reader.graph

    def choose(c: int, *options: int) -> int:
        if g.dtypes[c] == _BOOL:
            return g.select(c, options[1], options[0])
        chosen = options[-1]
        for k in range(len(options) - 2, -1, -1):
            chosen = g.select(g.node(LOGIC["eq"], c, g.constant(k, g.dtypes[c])), options[k], chosen)
        return chosen

    return [each(choose, which, *cases)]


def _ordered(name: str) -> Any:
    """le_to, lt_to: the order of all numbers, NaN behind them and equal to itself."""

    def compare(g: Graph, a: int, b: int) -> int:
        behind = g.node(LOGIC["ne"], b, b)
        if name == "lt":
            behind = LOGIC["and"].on(g)(behind, g.node(LOGIC["eq"], a, a))
        return LOGIC["or"].on(g)(g.node(LOGIC[name], a, b), behind)

    return lambda reader, eqn, *arrays: [each(functools.partial(compare, reader.graph), *arrays)]


def _converted(reader: Reader, eqn: Any, a: Nodes) -> list[Nodes]:
    g, target = reader.graph, np.dtype(eqn.params["new_dtype"])
    return [each(lambda x: x if g.dtypes[x] == target else g.node(convert(target), x), a)]


def _reduced(reader: Reader, eqn: Any, a: Nodes) -> list[Nodes] | None:
    """Nothing, where it names the type's own precision."""
    own, p = jnp.finfo(eqn.invars[0].aval.dtype), eqn.params
    return [a] if (p["exponent_bits"], p["mantissa_bits"]) == (own.nexp, own.nmant) else None


def _same(reader: Reader, eqn: Any, *arrays: Nodes) -> list[Nodes]:
    return list(arrays)


def _before(bind: Any) -> tuple[Any, ...]:
    return lambda a, b: bind.bind(a, b), _REAL, np.array([np.nan, -1.5])


CHOICES: dict[str, Entry] = entries(
    Entry(
        name="select_n",
        read=_select_n,
        inside=small_inside,
        example=(lambda i, a: lax.select_n(i, a, -a), _TRUTH, _REAL),
    ),
    Entry(name="le_to", read=_ordered("le"), inside=small_inside, example=_before(lax.le_to_p)),
    Entry(name="lt_to", read=_ordered("lt"), inside=small_inside, example=_before(lax.lt_to_p)),
    Entry(
        name="convert_element_type",
        takes=(takes(new_dtype=ANY, weak_type=ANY, sharding=ANY),),
        read=_converted,
        any_type=True,
        inside=small_inside,
        moves=True,
        example=(lambda a: a.astype(np.float32), _REAL),
    ),
    Entry(
        name="reduce_precision",
        takes=(takes(exponent_bits=ANY, mantissa_bits=ANY),),
        read=_reduced,
        inside=small_inside,
        example=(lambda a: lax.reduce_precision(a, 11, 52), _REAL),
    ),
    Entry(name="copy", read=_same, any_type=True, inside=small_inside, moves=True, example=(jnp.copy, _REAL)),
    Entry(
        name="optimization_barrier",
        read=_same,
        any_type=True,
        inside=always_inside,
        moves=True,
        example=(lax.optimization_barrier, _REAL),
    ),
    Entry(name="round", takes=(takes(rounding_method=ANY),), inside=small_inside, example=(lax.round, _REAL)),
)
