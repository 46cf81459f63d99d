"""Checks of numbers, names and functions that users pass, with common messages.

Every value that is declared, passed to a call, used as a guess, or made a constant by `bake` is checked here.
"""

from __future__ import annotations

import difflib
import functools
import inspect
import numbers
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from .errors import InputError, TwistaxError


def reals(place: str, value: Any, error: type[Exception], free: bool = False) -> np.ndarray:
    """A value as an array of real numbers: float64, or bool if all entries are booleans.

    Accepted are integers, floats of any precision and booleans of Python, NumPy or JAX, alone or in nested lists. Other
    objects raise an error: text, complex numbers, None, masked entries.

    Args:
        place: the name of the value in messages.
        error: the class of the error.
        free: whether None is accepted for a free entry; it becomes NaN.
    """
    _need_unmasked(place, value, error)
    try:
        array = np.asarray(value)
    except jax.errors.TracerArrayConversionError:
        raise error(
            f"{place} expects numbers, got a traced JAX value.\n"
            "  fix: declare a tx.Parameter and pass the value through params"
        ) from None
    except TwistaxError as wrong:  # of an expression
        raise error(f"{place} expects real numbers, got {short(value)}. {wrong}") from None
    except (TypeError, ValueError) as wrong:
        ragged = ", as many in each list" if "inhomogeneous" in str(wrong) else ""
        raise error(f"{place} expects real numbers{ragged}, got {short(value)}") from None
    if array.dtype == object:  # Python's own: fractions, long integers, None
        entries = [np.nan if entry is None and free else entry for entry in array.ravel()]
        times = np.timedelta64  # which NumPy counts among the integers
        strangers = [entry for entry in entries if not isinstance(entry, numbers.Real) or isinstance(entry, times)]
        if strangers:
            raise error(f"{place} expects real numbers, got {short(strangers[0])}")
        try:
            array = np.array([float(entry) for entry in entries]).reshape(array.shape)
        except OverflowError:
            raise error(f"{place} expects numbers that fit in float64, got {short(value)}") from None
    if array.dtype == bool:
        return array
    if jnp.issubdtype(array.dtype, jnp.complexfloating):
        raise error(f"{place} expects real numbers, got {array.dtype}")
    if not _real(array.dtype):
        raise error(f"{place} expects real numbers, got {short(value)} of dtype {array.dtype}")
    if array.dtype.itemsize <= 8:  # float64 holds all of them; to look takes 4 us
        return array.astype(np.float64)
    with np.errstate(over="ignore"):
        floats = array.astype(np.float64)
    if np.any(np.isinf(floats) & ~np.isinf(array)):
        raise error(f"{place} expects numbers that fit in float64, got {short(value)}")
    return floats


def _real(dtype: Any) -> bool:
    """Whether it is one of real numbers. NumPy counts differences of times among the integers."""
    integers = jnp.issubdtype(dtype, jnp.integer) and not jnp.issubdtype(dtype, np.timedelta64)
    return bool(integers or jnp.issubdtype(dtype, jnp.floating))


def _need_unmasked(place: str, value: Any, error: type[Exception]) -> None:
    """Raise the error where an entry is masked, in lists too: NumPy would make NaN, or the number beneath, of it."""
    try:
        masked = _masked(value)
    except RecursionError:  # a list that holds itself
        raise error(f"{place} expects real numbers, got {short(value)}") from None
    if masked:
        raise error(f"{place} expects real numbers, got masked entries.\n  fix: fill them, value.filled(...)")


def _masked(value: Any) -> bool:
    if isinstance(value, (list, tuple)):  # long ones of Python's own numbers are passed over at once
        return not {*map(type, value)} <= {float, int} and any(map(_masked, value))
    return isinstance(value, np.ma.MaskedArray) and bool(np.ma.is_masked(value))


def real_array(place: str, value: Any, error: type[Exception] = InputError) -> jax.Array | np.ndarray:
    """As `reals`, but arrays of JAX and traced values are not converted, alone or in lists."""
    from .jax_inside import is_traced  # not at import: it loads much of JAX that `import jax` does not

    _need_unmasked(place, value, error)
    if not (isinstance(value, jax.Array) or is_traced(value)):
        return reals(place, value, error)
    try:
        numbers = jnp.asarray(value)
    except (TypeError, ValueError, OverflowError):
        raise error(f"{place} expects real numbers, got {short(value)}") from None
    if numbers.dtype != bool and not _real(numbers.dtype):
        raise error(f"{place} expects real numbers, got {numbers.dtype}")
    return numbers


def number(
    place: str,
    value: Any,
    what: str = "a finite number",
    holds: Callable[[float], Any] = np.isfinite,
    error: type[Exception] = InputError,
) -> Any:
    """The value itself if it is one real number that satisfies a condition, which `what` describes; traced ones
    pass.
    """
    from .jax_inside import is_traced

    if is_traced(value) and np.shape(value) == ():
        return value
    boxed = isinstance(value, np.ndarray) and value.dtype == object and value.shape == ()
    entry = value.item() if boxed else value
    single = isinstance(entry, numbers.Real) or (isinstance(entry, (np.ndarray, jax.Array)) and entry.shape == ())
    try:
        kind = np.asarray(entry).dtype if single else np.dtype(bool)
        right = not _masked(entry) and (kind.kind == "O" or _real(kind)) and holds(float(entry))
    except (TypeError, OverflowError):  # a key of random numbers; a number beyond float64
        right = False
    if not right:
        raise error(f"{place} must be {what}, got {short(value)}")
    return value


def instance(place: str, value: Any, kind: Any, like: str, error: type[Exception]) -> None:
    """Raise the error unless the value is an instance of a class, which `like` describes."""
    if not isinstance(value, kind):
        raise error(f"{place} expects {like}, got {short(value)}")


def whole(place: str, value: Any, least: int = 1, error: type[Exception] = InputError) -> int:
    """The value if it is a whole number that is at least `least`."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise error(f"{place} must be a whole number of {least} or more, got {short(value)}")
    return int(value)


def name_list(place: str, value: Any, error: type[Exception] = InputError) -> tuple[str, ...]:
    """Names, or one name, as a tuple without repetitions. Raises the error for other objects."""
    names = [value] if isinstance(value, str) else list(value) if isinstance(value, Iterable) else [None]
    if not all(isinstance(name, str) for name in names):
        raise error(f"{place} expects names, got {short(value)}")
    return tuple(dict.fromkeys(names))


def callable_with(place: str, function: Any, arguments: Sequence[str], error: type[Exception]) -> None:
    """Raise the error unless the value can be called with this number of arguments."""
    wanted = f"{place} expects a function of ({', '.join(arguments)})"
    if not callable(function):
        raise error(f"{wanted}, got {short(function)}")
    if isinstance(function, type):
        raise error(f"{wanted}, got the class {function.__name__}.\n  fix: pass an instance, {function.__name__}(...)")
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):  # some of what is compiled has none
        return
    try:
        signature.bind(*arguments)
    except TypeError:
        raise error(f"{wanted}, got one with the arguments {signature}") from None


P = ParamSpec("P")
R = TypeVar("R")


def known_arguments(
    place: str, error: type[Exception], elsewhere: Mapping[str, Callable[[], Callable[..., Any]]]
) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """A decorator that raises the error, in place of a TypeError, for an argument with an unknown name.

    Args:
        elsewhere: other functions that may have an argument with that name, such as "tx.trajectory.Problem", each with
            a function that returns it.
    """

    def decorated(function: Callable[P, R]) -> Callable[P, R]:
        known = [name for name in inspect.signature(function).parameters if not name.startswith(("self", "_"))]

        @functools.wraps(function)
        def checked(*args: P.args, **kwargs: P.kwargs) -> R:
            for name in kwargs:
                if name not in known and not name.startswith("_"):
                    homes = [at for at, of in elsewhere.items() if name in inspect.signature(of()).parameters]
                    fix = f".\n  fix: {homes[0]}(..., {name}=...)" if homes else ""
                    expected = ", ".join(known) if fix else listed(known, name)
                    raise error(f"{place} has no argument {name!r}; its arguments are: {expected}{fix}")
            return function(*args, **kwargs)

        return checked

    return decorated


def path_of(place: str, value: Any) -> Path:
    """A path, from a `Path` or a string. Raises InputError for other objects."""
    if not isinstance(value, (str, os.PathLike)):
        raise InputError(f"{place} expects a path, got {short(value)}")
    return Path(value)


def listed(names: Iterable[Any], name: Any = None) -> str:
    """Names for a message, in quotes, with a suggestion for a name that is not among them."""
    known = list(names)
    near = difflib.get_close_matches(name, [n for n in known if isinstance(n, str)], 1) if isinstance(name, str) else []
    return (", ".join(map(repr, known)) or "none") + (f".\n  fix: did you mean {near[0]!r}?" if near else "")


def short(value: Any) -> str:
    """A value in a message, with its type if that is not evident."""
    text = repr(value)
    text = text if len(text) <= 100 else f"{text[:100]} ..."
    plain = value is None or isinstance(value, (bool, int, float, complex, str, list, tuple))
    return text if plain or text.startswith(type(value).__name__) else f"{type(value).__name__}: {text}"
