"""Controls during an integration: constant arrays, tables over time, or a function of time."""

from __future__ import annotations

import contextlib
import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from ..checks import callable_with, real_array, short
from ..errors import InputError, ShapeError
from ..jax_inside import is_traced, of_one_device
from ..system.dynamics import Arrays, Dynamics
from ..system.inputs import is_finite, need_representable, read_values
from ..units import same_unit, seconds

#: Tables with more times are searched by bisection.
_SHORT = 64


def _floats(place: str, value: Any) -> jax.Array:
    """The value as a floating point array; known numbers stay NumPy arrays inside jit, so that they can be checked."""
    array = real_array(place, value)
    dtype = array.dtype if jnp.issubdtype(array.dtype, jnp.floating) else float
    # What the precision cannot hold becomes infinite, and is refused as that.
    with contextlib.nullcontext() if is_traced(array) else jax.ensure_compile_time_eval(), np.errstate(over="ignore"):
        return jnp.asarray(array, jax.dtypes.canonicalize_dtype(dtype))


def row_at(ts: jax.Array, t: jax.Array) -> jax.Array:
    """The last row whose time is not after t; -1 before the first row."""
    # Comparing with every time has a scalar form, which kernels require; for long tables it is slower.
    method = "compare_all" if ts.size <= _SHORT else "scan_unrolled"
    return jnp.searchsorted(ts, t, side="right", method=method) - 1


class ControlTable(ABC):
    """Values over time for one control. A pytree: other numbers in a table of the same size do not recompile.

    Attributes:
        ts: (n,) increasing times in s.
        values: (n, ...), the control's shape after the first axis.

    Raises:
        ShapeError: the shapes of the two do not match.
        InputError: times that do not increase, or have another unit than s; a value that is not finite.
    """

    #: The fewest rows that have a meaning; whether the last one holds on after its time.
    rows: int
    holds_on: bool

    def __init__(self, ts: Any, values: Any) -> None:
        name = type(self).__name__
        same_unit(f"{name}: ts", ts, seconds)
        self.ts, self.values = _floats(f"{name}: ts", ts), _floats(f"{name}: values", values)
        if self.ts.ndim != 1 or self.ts.shape[0] < self.rows:
            raise ShapeError(f"{name} expects ts with shape (n,), n >= {self.rows}, got {self.ts.shape}")
        if self.values.shape[:1] != self.ts.shape:
            raise ShapeError(
                f"{name} expects values with a row for each of the {self.ts.shape[0]} times, got {self.values.shape}"
            )
        known = None if is_traced(self.ts) else np.asarray(self.ts)
        if known is not None and not (np.diff(known) > 0).all():
            i = int(np.argmin(np.diff(known) > 0))
            raise InputError(f"{name} expects increasing ts, got {known[i]} before {known[i + 1]} in row {i}")
        for field in ("ts", "values"):
            if not is_finite(getattr(self, field)):
                raise InputError(f"{name} expects finite {field}, got {short(np.asarray(getattr(self, field)))}")

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        jax.tree_util.register_pytree_node(cls, lambda table: ((table.ts, table.values), None), cls._of)

    @classmethod
    def _of(cls, _: None, children: Sequence[Any]) -> ControlTable:
        table = object.__new__(cls)
        table.ts, table.values = children
        return table

    def astype(self, dtype: Any) -> ControlTable:
        """The same table in another precision. Raises InputError if its values cannot be represented."""
        if self.ts.dtype == dtype and self.values.dtype == dtype:
            return self
        for place, array in (("times", self.ts), ("values", self.values)):
            need_representable(f"{place} of a table of controls", array, dtype)
        return self._of(None, (self.ts.astype(dtype), self.values.astype(dtype)))

    @property
    def first(self) -> Any:
        """The first row; a NumPy array if it is known."""
        return self.values[0] if is_traced(self.values) else np.asarray(self.values)[0]

    @property
    def times(self) -> Any:
        """The times `ts`; a NumPy array if they are known."""
        return self.ts if is_traced(self.ts) else np.asarray(self.ts)

    @property
    def jumps(self) -> Any:
        """The times at which the value or its derivative is discontinuous; a NumPy array if they are known."""
        return self.times[1:] if self.holds_on else self.times

    def during(self, t: jax.Array, h: jax.Array, within: bool = False) -> Callable[[jax.Array], jax.Array]:
        """The value as a function of the times within the step from t to t + h.

        The table is evaluated slightly closer to the middle of the step: by much less than a step, but more than
        round-off. So at a jump or a kink, the value is that on the side of the step, for any step size.

        Args:
            within: whether the step lies between two rows, which are then looked up once for all of its times.
        """
        middle, eps = t + 0.5 * h, float(jnp.finfo(t.dtype).eps)
        rounding = 8.0 * eps * jnp.abs(middle) / jnp.maximum(jnp.abs(h), float(jnp.finfo(t.dtype).tiny))
        hair = jax.lax.stop_gradient(jnp.clip(rounding, float(np.sqrt(eps)), 1.0))

        def inner(time: jax.Array) -> jax.Array:
            return time + hair * (middle - time)

        if within:
            # Of a table that is held the first row is no end of a step, which may begin before it.
            row, missing = self._row(middle), self._missing(inner(t))
            return lambda time: jnp.where(missing, jnp.nan, self._value(row, time))

        def value(time: jax.Array) -> jax.Array:
            return jnp.where(self._missing(inner(time)), jnp.nan, self._value(self._row(inner(time)), time))

        return value

    def _missing(self, t: jax.Array) -> jax.Array:
        return t < self.ts[0] if self.holds_on else (t < self.ts[0]) | (t > self.ts[-1])

    @abstractmethod
    def _value(self, row: jax.Array, time: jax.Array) -> jax.Array:
        """The value at a time of the piece that begins with a row."""

    def check_span(self, place: str, t0: float, t1: float) -> None:
        """Raise InputError if a known table does not cover a span, up to round-off."""
        if is_traced(self.ts):
            return
        room = 8.0 * float(jnp.finfo(self.ts.dtype).eps) * max(abs(t0), abs(t1))
        first, last = np.asarray(self.ts)[[0, -1]].tolist()  # NumPy's: inside jit JAX's indexing traces
        if first > t0 + room:
            raise InputError(
                f"{place} begins at {first:g}, but the integration begins at t0 = {t0:g}.\n  fix: add a row at t0"
            )
        if last < t1 - room and not self.holds_on:
            raise InputError(
                f"{place} ends at {last:g}, but the integration ends at t1 = {t1:g}.\n  fix: add a row at t1"
            )

    def _row(self, t: jax.Array) -> jax.Array:
        """The last row whose time is not after t, of those that begin a piece."""
        return jnp.clip(row_at(self.ts, t), 0, self.ts.shape[0] - self.rows)


class ZeroOrderHold(ControlTable):
    """A control that is piecewise constant (a zero-order hold): row i from ts[i] until ts[i + 1], the last row from its
    time on.

    There is no value before ts[0]: an integration must not begin earlier.

    `tx.integrate` ends a step at every jump, and a step that starts or ends at a jump uses the value inside the step
    for all of its stages. So the method keeps its order.

    Args:
        ts: (n,) times in s, increasing.
        values: (n, *shape) rows of the control's shape, in its unit.
    Raises:
        ShapeError: `values` does not have a row for each time.
        InputError: times that do not increase, or a value that is not finite.
    """

    rows = 1
    holds_on = True

    def _value(self, row: jax.Array, time: jax.Array) -> jax.Array:
        return self.values[row]


class PiecewisePolynomial(ControlTable):
    """A control that is a polynomial in time between the times of a table: from ts[i] until ts[i + 1]
    $sum_k values[i, k] (t - ts[i])^k / k!$. The last polynomial continues without end.

    So values[i] contains the value at ts[i] and the right-hand derivatives. There is no value before ts[0].

    Args:
        ts: (n,) times in s, increasing.
        values: (n, degree + 1, *shape) the value, then its derivatives, the k-th in the control's unit per `s^k`.
    Raises:
        ShapeError: `values` does not have a row for each time, or has no axis of derivatives.
        InputError: times that do not increase, or a value that is not finite.
    """

    rows = 1
    holds_on = True

    def __init__(self, ts: Any, values: Any) -> None:
        super().__init__(ts, values)
        if self.values.ndim < 2 or not self.values.shape[1]:
            raise ShapeError(
                f"PiecewisePolynomial expects values with shape (n, degree + 1, ...), got {self.values.shape}"
            )

    @property
    def first(self) -> Any:
        return super().first[0]

    def _value(self, row: jax.Array, time: jax.Array) -> jax.Array:
        coefficients, since = self.values[row], time - self.ts[row]
        result = coefficients[-1]
        for order in range(self.values.shape[1] - 1, 0, -1):
            result = coefficients[order - 1] + since / order * result
        return result


class FirstOrderHold(ControlTable):
    """A control that is interpolated linearly between the rows of a table (a first-order hold).

    There is no value outside of `ts`: the table must cover the whole integration.

    Args, Raises: `ts` and `values` as for `ZeroOrderHold`, with at least two rows.
    """

    rows = 2
    holds_on = False

    def _value(self, row: jax.Array, time: jax.Array) -> jax.Array:
        start, end = self.ts[row], self.ts[row + 1]
        return self.values[row] + (time - start) / (end - start) * (self.values[row + 1] - self.values[row])


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class ByName:
    """Controls by name, each a constant array or a table."""

    values: Mapping[str, Any]

    def sample(self, t: Any) -> Mapping[str, Any]:
        """A value of every control, for checks of names and shapes."""
        return {name: v.first if isinstance(v, ControlTable) else v for name, v in self.values.items()}

    def check_span(self, t0: float, t1: float) -> None:
        """Raise InputError where a known table does not cover a span."""
        for name, value in self.values.items():
            if isinstance(value, ControlTable):
                value.check_span(f"u[{name!r}]", t0, t1)

    @property
    def jumps(self) -> list[Any]:
        """The times at which tables jump."""
        return [value.jumps for value in self.values.values() if isinstance(value, ControlTable)]

    def prepared(self, arrays: Mapping[str, Any], dtype: Any) -> ByName:
        """The same controls in the precision of the state; `arrays` are already converted."""
        return ByName(
            {n: v.astype(dtype) if isinstance(v, ControlTable) else arrays[n] for n, v in self.values.items()}
        )

    def during(
        self, dynamics: Dynamics, t: jax.Array, h: jax.Array, within: bool = False
    ) -> Callable[[jax.Array], Arrays]:
        """The prepared controls as a function of the times within the step from t to t + h, as in `ControlTable`."""
        tables = {
            name: value.during(t, h, within) for name, value in self.values.items() if isinstance(value, ControlTable)
        }
        constants = {name: value for name, value in self.values.items() if name not in tables}
        return lambda time: constants | {name: value(time) for name, value in tables.items()}


class OfTime:
    """Controls as a function of time. A pytree of the traced values that the function closes over."""

    #: No known times: the user passes the jumps of a function by `jumps=`.
    jumps: Sequence[Any] = ()

    def __init__(self, function: Callable[..., Mapping[str, Any]], inputs: Sequence[Any] = ()) -> None:
        self.function, self.inputs = function, inputs

    def sample(self, t: Any) -> Mapping[str, Any]:
        """The controls at a time. Raises InputError if the function does not return a dict, or requires a concrete
        number as time.
        """
        try:
            values = self.function(t, *self.inputs)
        except (jax.errors.ConcretizationTypeError, jax.errors.TracerArrayConversionError) as error:
            raise InputError(
                f"the function u requires a number t, but t is traced: {str(error).splitlines()[0]}\n"
                "  fix: use jnp.where(t < ..., a, b) in place of if, and jax.numpy in place of NumPy and math"
            ) from None
        if not isinstance(values, Mapping):
            raise InputError(f"the function u must return a dict by control name, got {type(values).__name__}")
        return values

    def opened(self, t: jax.Array) -> OfTime:
        """The same function with the traced values that it closes over as inputs, so that derivatives find them."""
        with of_one_device():
            function, inputs = jax.closure_convert(self.function, t)
        return OfTime(function, inputs) if inputs else self

    def prepared(self, arrays: Mapping[str, Any], dtype: Any) -> OfTime:
        """The controls themselves: there is nothing to cast before the function is called."""
        return self

    def during(
        self, dynamics: Dynamics, t: jax.Array, h: jax.Array, within: bool = False
    ) -> Callable[[jax.Array], Arrays]:
        """The function, with its values checked and converted."""
        return lambda time: read_values("u(t)", dynamics.controls, self.sample(time), time.dtype)


def _flattened(signal: OfTime) -> tuple[tuple[Any, ...], Any]:
    plain = jax.tree_util.all_leaves([signal.function])
    return (None if plain else signal.function, signal.inputs), signal.function if plain else None


jax.tree_util.register_pytree_node(
    OfTime, _flattened, lambda plain, children: OfTime(children[0] if plain is None else plain, children[1])
)

Signals: TypeAlias = ByName | OfTime


def controls_of(u: Any) -> Signals:
    """The controls `u`, as `ByName` or `OfTime`. Raises InputError for other objects."""
    if u is None:
        return ByName({})
    if isinstance(u, Mapping):
        for name, value in u.items():
            if callable(value):
                raise InputError(
                    f"u[{name!r}] is a function.\n"
                    f"  fix: pass one function of time for all controls, u=lambda t: {{{name!r}: ...}}, or a table"
                )
        return ByName(dict(u))
    if isinstance(u, ControlTable):
        raise InputError(
            f"u must be a dict by control name, got {type(u).__name__}.\n  fix: pass u={{'name of the control': table}}"
        )
    if callable(u):
        callable_with("u", u, ["t"], InputError)
        return OfTime(u)
    raise InputError(f"u must be a dict of arrays or tables, or a function of t, got {type(u).__name__}")
