"""The arguments (t, x, u, params) of lowered functions: checks, and conversion to one precision."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..checks import listed, real_array
from ..errors import InputError
from ..expr import Control, Inputs, Leaf, Parameter, State
from ..jax_inside import is_traced

Values = Mapping[str, Any]


def precision(*groups: Values | None) -> Any:
    """The precision of a call: that of the widest array in single or double precision in the first group that has one.

    Python numbers, integers and arrays in half precision are ignored, wider arrays count as double; without any array
    it is JAX's default.
    """
    for values in groups:
        arrays = values.values() if isinstance(values, Mapping) else ()
        dtypes = [v.dtype for v in arrays if hasattr(v, "dtype")]
        sizes = [min(d.itemsize, 8) for d in dtypes if jnp.issubdtype(d, jnp.floating) and d.itemsize >= 4]
        if sizes:
            return jax.dtypes.canonicalize_dtype(f"float{8 * max(sizes)}")
    return jax.dtypes.canonicalize_dtype(float)


def _shaped(leaf: Any, kind: str) -> str:
    """A hint for a value of a wrong shape."""
    made = {"SE3": "tx.pose(position=..., rotation=...) builds a pose", "SO3": "tx.pose(...)[:3, :3] is a rotation"}
    if (group := getattr(getattr(leaf, "group", None), "name", None)) in made:
        return f"{made[group]}; map over batches with jax.vmap"
    table = "; values over time are a table, tx.ZeroOrderHold(ts, values)" if kind == "u" else ""
    return f"one point at a time; map over batches with jax.vmap{table}"


def read_values(
    kind: str, leaves: Iterable[Any], values: Values | None, dtype: Any, on_host: bool = False
) -> dict[str, Any]:
    """Check names and shapes, and convert the values. Missing names are checked by the caller.

    Args:
        leaves: objects with a name and a shape.
        on_host: whether to leave NumPy arrays unchanged, because a jitted function accepts them faster than JAX
            converts them.
    Raises:
        InputError: an unknown key, a wrong shape, or values that are not numeric.
    """
    known = {leaf.name: leaf for leaf in leaves}
    if values is None:
        return {}
    if not isinstance(values, Mapping):
        raise InputError(f"{kind} must be a dict from names to arrays, got {type(values).__name__}")
    unknown = [name for name in values if name not in known]
    if unknown:
        leaf_name = getattr(unknown[0], "name", None)
        hint = f"\n  fix: values go by name here: {{{leaf_name!r}: ...}}" if leaf_name in known else ""
        raise InputError(f"unknown key {unknown[0]!r} in {kind}; expected: {listed(known, unknown[0])}{hint}")
    result = {}
    for name, value in values.items():
        place = f"{kind}[{name!r}]"
        array = real_array(place, value)
        if array.shape != known[name].shape:
            raise InputError(
                f"{kind}[{name!r}] expects shape {known[name].shape}, got {array.shape}.\n"
                f"  fix: {_shaped(known[name], kind)}"
            )
        result[name] = cast(place, array, dtype, on_host)
    return result


def is_finite(value: Any) -> bool:
    """Whether all entries of an array are finite, as far as they are known."""
    return is_traced(value) or bool(np.isfinite(np.asarray(value)).all())


def cast(place: str, array: jax.Array | np.ndarray, dtype: Any, on_host: bool = False) -> jax.Array | np.ndarray:
    """The array in the precision of the call. Raises InputError if it cannot be represented in it.

    JAX arrays stay on their devices. Arrays in a wider precision are read on the host, which waits for them.
    """
    need_representable(place, array, dtype)
    if isinstance(array, np.ndarray):
        array = array.astype(dtype)
        if on_host:
            return array
    return jnp.asarray(array, dtype)


def need_representable(place: str, array: jax.Array | np.ndarray, dtype: Any) -> None:
    """Raise InputError if known numbers of an array overflow in a precision."""
    wider = array.dtype.itemsize > np.dtype(dtype).itemsize and jnp.issubdtype(array.dtype, jnp.floating)
    if not wider or is_traced(array):
        return
    known = np.asarray(array)
    with np.errstate(over="ignore"):
        overflows = np.isinf(known.astype(dtype)) & np.isfinite(known)
    if overflows.any():
        raise InputError(
            f"{place} has {np.abs(known[overflows]).max():.3g}, which does not fit in {np.dtype(dtype).name}.\n"
            '  fix: use other units, or double precision: jax.config.update("jax_enable_x64", True) and float64 arrays'
        )


class _Slot(NamedTuple):
    """A leaf, and what each value of it is compared with."""

    leaf: Leaf
    name: str
    shape: tuple[int, ...]
    group: Any


class CallArguments:
    """The leaves of a function, sorted by kind once, to check and convert the values of each call.

    Args:
        leaves: states, controls and parameters.
    """

    def __init__(self, leaves: Iterable[Leaf]) -> None:
        slots = [_Slot(leaf, leaf.name, leaf.shape, getattr(leaf, "group", None)) for leaf in leaves]
        self._states, self._controls, self._parameters = (
            [slot for slot in slots if isinstance(slot.leaf, kind)] for kind in (State, Control, Parameter)
        )
        self._known = {slot.name for slot in slots}

    def prepare(
        self,
        required: Collection[str],
        t: Any,
        x: Values | None,
        u: Values | None,
        params: Values | None,
        *,
        names: Sequence[str] = ("t", "x", "u", "params"),
        on_host: bool = False,
        spare: bool = False,
    ) -> Inputs:
        """The checked arguments. Their precision is that of x; or, if x has no float array, of u, params or t.

        Args:
            required: the names that must be present.
            names: the names of the arguments in messages.
            on_host: whether to leave NumPy arrays unchanged.
            spare: whether x may have states that are not read; they count for the precision.
        Raises:
            InputError: an unknown key, a wrong shape, or a missing value that is read.
        """
        dtype = precision(x, u, params, {"t": t})
        if spare and isinstance(x, Mapping):
            x = {name: value for name, value in x.items() if name in self._known or not isinstance(name, str)}
        time = real_array(names[0], t)
        if time.shape != ():
            raise InputError(f"{names[0]} expects a scalar, got shape {time.shape}")
        states = read_values(names[1], self._states, x, dtype, on_host)
        controls = read_values(names[2], self._controls, u, dtype, on_host)
        parameters = read_values(names[3], self._parameters, params, dtype, on_host)
        for kind, slots, name, values in (
            ("State", self._states, names[1], states),
            ("Control", self._controls, names[2], controls),
        ):
            for slot in slots:
                if slot.name in required and slot.name not in values:
                    raise InputError(
                        f"{kind} {slot.name!r} is missing in {name}, which has: {listed(values)}.\n"
                        f"  fix: pass {name}={{{slot.name!r}: ...}} of shape {slot.shape}"
                    )
        inputs = Inputs(cast(names[0], time, dtype, on_host), states, controls, parameters, dtype)
        # Defaults become inputs here: a compiled function takes them like other values.
        for leaf in (slot.leaf for slot in self._parameters if slot.name in required and slot.name not in parameters):
            default = leaf.value if on_host and isinstance(leaf, Parameter) else None
            parameters[leaf.name] = leaf.read(inputs) if default is None else default.astype(dtype)
        return inputs
