"""Methods with effects inside programs of JAX: they run with each run of the program, in the order of the program."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from ...jax_inside import io_callback, is_tracing
from ...system import name_of

Method = TypeVar("Method", bound=Callable[..., Any])


def in_order(
    shapes: Callable[[Any], Mapping[str, tuple[int, ...]]] | None = None,
    checked: Callable[[Any, Any], Any] = lambda self, values: values,
) -> Callable[[Method], Method]:
    """A decorator of methods: within a traced program a call is an ordered host callback.

    Args:
        shapes: of the results by name, from the object; None for a method without results.
        checked: each argument as it is passed on; raises an error while the program is traced.
    """

    def decorate(method: Method) -> Method:
        @functools.wraps(method)
        def call(self: Any, *arguments: Any, **options: Any) -> Any:
            if not is_tracing():
                return method(self, *arguments, **options)
            dtype = jnp.result_type(float)

            def back(arguments: Any, options: Any) -> Any:
                return jax.tree.map(lambda value: np.asarray(value, dtype), method(self, *arguments, **options))

            results = shapes and {name: jax.ShapeDtypeStruct(shape, dtype) for name, shape in shapes(self).items()}
            passed = [checked(self, _by_names(value)) for value in arguments]
            by_name = {name: checked(self, _by_names(value)) for name, value in options.items()}
            return io_callback(back, results, passed, by_name, ordered=True)

        return call  # type: ignore[return-value]

    return decorate


def _by_names(values: Any) -> Any:
    """A dict with names in place of leaves, which JAX can sort."""
    return {name_of(key): value for key, value in values.items()} if isinstance(values, Mapping) else values
