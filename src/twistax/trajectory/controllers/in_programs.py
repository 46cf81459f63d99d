"""Methods with effects inside programs of JAX: they run with each run of the program, in the order of the program."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import jax
import jax.custom_batching
import jax.numpy as jnp
import numpy as np

from ...errors import TrajectoryError
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
            run = lambda values: io_callback(back, results, *values, ordered=True)  # noqa: E731
            return _alone(f"{type(self).__name__}.{method.__name__}", run)((passed, by_name))

        return call  # type: ignore[return-value]

    return decorate


def _alone(name: str, function: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """A function that raises TrajectoryError where JAX batches or differentiates it."""

    def refused(*_: Any) -> Any:
        raise TrajectoryError(
            f"{name} changes the plan of the controller, so jax.vmap and jax.grad do not support it.\n"
            "  fix: use tx.trajectory.solution(problem), a function of the initial state with derivatives"
        )

    unbatched = jax.custom_batching.custom_vmap(function)
    unbatched.def_vmap(refused)
    constant = jax.custom_jvp(lambda values: unbatched(values))
    constant.defjvp(refused)
    return constant


def _by_names(values: Any) -> Any:
    """A dict with names in place of leaves, which JAX can sort."""
    return {name_of(key): value for key, value in values.items()} if isinstance(values, Mapping) else values
