"""The load of an entry of a constant table at a computed index, as one operation of JAX.

As an index into a constant array it would be a gather, whose table is an ordinary operand: scalar programs would make a
node of each of its numbers, and select among them.
"""

from __future__ import annotations

import functools
import hashlib
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...jax_inside import Primitive, ad, batching, jet, mlir


class Table:
    """A one-dimensional array of numbers, compared by value.

    Attributes:
        values: (n,), float64.
        name: letters and digits, other ones for other numbers.
    """

    def __init__(self, values: Any) -> None:
        self.values = np.array(values, np.float64).reshape(-1)
        self.values.flags.writeable = False
        self.name = f"table_{hashlib.blake2b(self.values.tobytes(), digest_size=12).hexdigest()}"

    def numbers(self, dtype: Any) -> np.ndarray:
        """The values in another type: infinite beyond its range."""
        with np.errstate(over="ignore"):
            return self.values.astype(dtype)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Table) and self.name == other.name

    def __hash__(self) -> int:
        return hash(self.name)

    def __repr__(self) -> str:
        return f"{self.name}[{len(self.values)}]"


def load(table: Table, place: jax.Array, dtype: Any, offset: int = 0) -> jax.Array:
    """table[place + offset], entry by entry, in a floating-point type; its derivative is zero.

    Args:
        place: whole numbers such that all that is read is in the table: nothing checks it.
    """
    return _load_p.bind(place, table=table, offset=offset, dtype=np.dtype(dtype))


_load_p = Primitive("table_load")


def _taken(place: jax.Array, *, table: Table, offset: int, dtype: np.dtype[Any]) -> jax.Array:
    return jnp.asarray(table.numbers(dtype)).at[place + offset].get(mode="promise_in_bounds")


def _zero_jvp(primals: Any, tangents: Any, **params: Any) -> Any:
    value = _load_p.bind(*primals, **params)
    return value, ad.Zero(jax.typeof(value).to_tangent_aval())


def _zero_series(primals: Any, series: Any, **params: Any) -> Any:
    value = _load_p.bind(*primals, **params)
    return value, [jnp.zeros_like(value) for _ in series[0]]


def _batched(arguments: Any, axes: Any, **params: Any) -> Any:
    return _load_p.bind(*arguments, **params), axes[0]


_load_p.def_impl(functools.partial(jax.jit, static_argnames=("table", "offset", "dtype"))(_taken))
_load_p.def_abstract_eval(lambda place, table, offset, dtype: place.update(dtype=dtype, weak_type=False))
batching.primitive_batchers[_load_p] = _batched
ad.primitive_jvps[_load_p] = _zero_jvp
mlir.register_lowering(_load_p, mlir.lower_fun(_taken, multiple_results=False))
_taylor_rules: dict[Any, Any] = jet.jet_rules
_taylor_rules[_load_p] = _zero_series
