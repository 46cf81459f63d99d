"""The arguments of every lowered function: one signature (t, x, u, params), checked and brought to one precision."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..errors import InputError
from ..expr import Control, Inputs, Leaf, Parameter, State
from ..expr.reals import reals
from ..jax_inside import is_traced

Values = Mapping[str, Any]


def precision(*groups: Values | None) -> Any:
    """The precision all values take: the widest float array of the first group that has one.

    Python numbers and integers have none; if nobody has one it is JAX's default float.
    """
    for values in groups:
        given = values.values() if isinstance(values, Mapping) else ()
        dtypes = [np.dtype(v.dtype) for v in given if hasattr(v, "dtype")]
        floats = [d for d in dtypes if jnp.issubdtype(d, jnp.floating)]
        if floats:
            return jax.dtypes.canonicalize_dtype(max(floats, key=lambda d: d.itemsize))
    return jax.dtypes.canonicalize_dtype(float)


def read_values(kind: str, leaves: Iterable[Leaf], values: Values | None, dtype: Any) -> dict[str, jax.Array]:
    """Check names and shapes and cast. Missing names are left to the caller.

    Raises:
        InputError: an unknown key, a wrong shape, or not numbers.
    """
    known = {leaf.name: leaf for leaf in leaves}
    if values is None:
        return {}
    if not isinstance(values, Mapping):
        raise InputError(f"{kind} must be a dict from names to arrays, got {type(values).__name__}")
    unknown = [name for name in values if name not in known]
    if unknown:
        listed = ", ".join(map(repr, known)) or "none"
        raise InputError(f"unknown key {unknown[0]!r} in {kind}; expected: {listed}")
    found = {}
    for name, value in values.items():
        place = f"{kind}[{name!r}]"
        array = _array(place, value)
        if array.shape != known[name].shape:
            raise InputError(
                f"{kind}[{name!r}] expects shape {known[name].shape}, got {array.shape}.\n"
                "  fix: one point at a time; map over batches with jax.vmap"
            )
        found[name] = _cast(place, array, dtype)
    return found


def is_finite(value: Any) -> bool:
    """Whether all entries of an array are finite, as far as they are known."""
    return is_traced(value) or bool(np.isfinite(np.asarray(value)).all())


def _array(place: str, value: Any) -> jax.Array | np.ndarray:
    """The value as an array of real numbers."""
    if not (isinstance(value, jax.Array) or is_traced(value)):
        return reals(place, value, InputError)
    try:
        array = jnp.asarray(value)  # also lists with traced entries
    except (TypeError, ValueError) as error:
        raise InputError(f"{place} is not an array of numbers: {error}") from None
    if jnp.issubdtype(array.dtype, jnp.complexfloating):
        raise InputError(f"{place} expects real numbers, got {array.dtype}")
    return array


def _cast(place: str, array: jax.Array | np.ndarray, dtype: Any) -> jax.Array:
    """The array in the precision of the call."""
    if isinstance(array, np.ndarray):
        with np.errstate(over="ignore"):
            cast = array.astype(dtype)
        if np.any(np.isinf(cast) & np.isfinite(array)):
            raise InputError(
                f"{place} has {np.abs(array).max():.3g}, which {np.dtype(dtype).name} cannot hold.\n"
                '  fix: other units, or double precision: jax.config.update("jax_enable_x64", True) and float64 arrays'
            )
        array = cast
    return jnp.asarray(array, dtype)


def prepare(
    leaves: Sequence[Leaf], required: set[str], t: Any, x: Values | None, u: Values | None, params: Values | None
) -> Inputs:
    """The checked arguments. `leaves` are all that may be given, `required` the names that are read.

    Their precision is that of x; where x has no float array, that of u, params or t, in this order.

    Raises:
        InputError: an unknown key, a wrong shape, a state, control or parameter value that is read and not there.
    """
    dtype = precision(x, u, params, {"t": t})
    kinds = {kind: [leaf for leaf in leaves if isinstance(leaf, kind)] for kind in (State, Control, Parameter)}
    states = read_values("x", kinds[State], x, dtype)
    controls = read_values("u", kinds[Control], u, dtype)
    values = read_values("params", kinds[Parameter], params, dtype)
    for given, leaf_kind, name in ((states, State, "x"), (controls, Control, "u")):
        missing = [leaf for leaf in kinds[leaf_kind] if leaf.name in required and leaf.name not in given]
        if missing:
            raise InputError(
                f"{leaf_kind.__name__} {missing[0].name!r} is missing: pass {name}={{{missing[0].name!r}: ...}} "
                f"of shape {missing[0].shape}"
            )
    time = _array("t", t)
    if time.shape != ():
        raise InputError(f"t expects a scalar, got shape {time.shape}")
    inputs = Inputs(_cast("t", time, dtype), states, controls, values, dtype)
    # Defaults enter here, as inputs, so that a compiled function takes them like any given value.
    for leaf in kinds[Parameter]:
        if leaf.name in required:
            values[leaf.name] = leaf.read(inputs)
    return inputs
