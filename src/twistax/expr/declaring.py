"""The declaration of fields by node classes, and the binding of constructor arguments to them."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import inspect
import itertools
import numbers
import pickle
import weakref
from collections.abc import Iterable
from typing import Any, NamedTuple

import jax
import numpy as np

from ..errors import ModelError, OperationError
from .moved import first_module

_MISSING = inspect.Parameter.empty


class Field(NamedTuple):
    """A declared field of a node class."""

    name: str
    operand: bool
    variadic: bool
    default: Any = _MISSING

    def shown(self, value: Any) -> bool:
        """Whether this static field is printed: only if it differs from its default."""
        if self.operand or self.variadic:
            return False
        return self.default is _MISSING or freeze(value) != freeze(self.default)


def declare_fields(cls: Any, constructor: Any) -> None:
    """Collect the annotated fields of a class after inherited ones, and set the signature of its constructor.

    `help` and editors show the fields, unless a class defines another constructor.
    """
    fields = {f.name: f for f in cls._fields}
    for name, annotation in inspect.get_annotations(cls).items():
        if "ClassVar" not in str(annotation):
            # A class, or its name where the module says `from __future__ import annotations`.
            kind = str(getattr(annotation, "__name__", annotation)).rpartition(".")[2]
            fields[name] = Field(name, kind == "Operand", kind == "Operands", cls.__dict__.get(name, _MISSING))
    cls._fields = tuple(fields.values())
    plain: Any = inspect.Parameter.POSITIONAL_OR_KEYWORD
    if any(f.variadic for f in cls._fields):
        plain = inspect.Parameter.KEYWORD_ONLY
    kinds = [inspect.Parameter.VAR_POSITIONAL if f.variadic else plain for f in cls._fields]
    cls._signature = inspect.Signature(
        [inspect.Parameter(f.name, kind, default=f.default) for f, kind in zip(cls._fields, kinds)]
    )
    taken = cls._signature if cls.__init__ is constructor else inspect.signature(cls.__init__)
    cls.__signature__ = taken.replace(parameters=[p for p in taken.parameters.values() if p.name != "self"])


def bind_fields(cls: Any, args: tuple[Any, ...], kwargs: dict[str, Any]) -> dict[str, Any]:
    """The value of every field, from the constructor's arguments."""
    try:
        bound = cls._signature.bind(*args, **kwargs)
    except TypeError as error:
        raise OperationError(f"{cls.__name__}{cls._signature}: {error}") from None
    bound.apply_defaults()
    for field in cls._fields:
        if field.variadic and len(bound.arguments[field.name]) < cls.fewest:
            count, least = len(bound.arguments[field.name]), ("one", "two")[cls.fewest - 1]
            raise ModelError(f"{cls.__name__} requires {least} or more {field.name}, got {count}")
    return bound.arguments


def positive(owner: object, name: str, value: object, unit: str = "") -> None:
    """Raise ModelError unless a value is a positive, finite number."""
    number = isinstance(value, numbers.Real) and not isinstance(value, bool)
    if not (number and 0.0 < float(value) < np.inf):  # type: ignore[arg-type]
        unit = f" of {unit}" if unit else ""
        raise ModelError(f"{type(owner).__name__} expects {name} to be a positive number{unit}, got {value!r}")


def digest(cls: type, static_key: Any, keys: Iterable[str]) -> str:
    """The structural key of a node: of its class, its static data and the keys of its children."""
    hashed = hashlib.blake2b(digest_size=16)
    for part in (f"{first_module(cls)}.{cls.__qualname__}", repr(static_key), *keys):
        hashed.update(part.encode())
    return hashed.hexdigest()


def freeze(value: Any) -> Any:
    """Static data in a form that compares and prints by content, for structural keys.

    Objects without a key are represented by their pickled bytes. Callables, and objects that cannot be pickled, are
    compared by identity.
    """
    if isinstance(value, float):
        return float(value).hex()
    if isinstance(value, jax.Array) and jax.dtypes.issubdtype(value.dtype, jax.dtypes.prng_key):
        return (str(value.dtype), freeze(jax.random.key_data(value)))
    if isinstance(value, functools.partial):
        return ("partial", freeze((value.func, value.args, value.keywords)))
    if isinstance(value, (np.ndarray, np.generic, jax.Array)):
        array = np.asarray(value)
        if isinstance(value, np.ma.MaskedArray):
            return ("masked", freeze(array), freeze(np.ma.getmaskarray(value)))
        if array.dtype == object:
            return ("objects", array.shape, freeze(array.tolist()))
        return (str(array.dtype), array.shape, _digest(array.tobytes()))
    if isinstance(value, (tuple, list)):  # as indices they mean different entries
        items = tuple(freeze(item) for item in value)
        return ("list", *items) if isinstance(value, list) else items
    if isinstance(value, (set, frozenset)):
        return ("set", *sorted(repr(freeze(item)) for item in value))
    if isinstance(value, dict):
        return ("dict", *((freeze(name), freeze(item)) for name, item in value.items()))
    if isinstance(value, slice):
        return ("slice", value.start, value.stop, value.step)
    if callable(getattr(value, "key", None)):
        return value.key()
    if value is None or value is Ellipsis or type(value) in (bool, int, str, bytes, complex):
        return repr(value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = ((f.name, freeze(getattr(value, f.name))) for f in dataclasses.fields(value))
        return (f"{first_module(type(value))}.{type(value).__qualname__}", *fields)
    if not callable(value):  # pickle knows functions and classes by names, which may come to mean others
        try:
            return ("pickle", _digest(pickle.dumps(value)))
        except Exception:  # of whatever kind its class raises
            pass
    return ("object", _number_of(value))


def _digest(data: bytes) -> str:
    return hashlib.blake2b(data, digest_size=16).hexdigest()


_NUMBERS = itertools.count()
#: The numbers of objects that only their identity tells apart, by address; and those that must stay for that.
_IDENTITIES: dict[int, int] = {}
_KEPT: list[Any] = []


def _number_of(value: Any) -> int:
    """A number unique to an object, even if another object later has the same address."""
    new = next(_NUMBERS)
    number = _IDENTITIES.setdefault(id(value), new)
    if number == new:
        try:
            weakref.finalize(value, _IDENTITIES.pop, id(value), None)
        except TypeError:
            _KEPT.append(value)
    return number
