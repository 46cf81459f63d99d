"""The inside of JAX that compiles and runs: versions, devices, options and metadata of XLA, precision."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from types import FrameType
from typing import Any

import jax
import jax.numpy as jnp
import jaxlib
from jax.extend.backend import backends

from .programs import is_traced, is_tracing, undocumented

_set_xla_metadata = undocumented("jax.experimental.xla_metadata", "set_xla_metadata")


def jax_versions() -> tuple[str, str]:
    """Those of JAX and of what it is compiled in."""
    return jax.__version__, jaxlib.__version__


def small_calls_exist() -> bool:
    """Whether this JAX can attach to a function the attributes that make XLA compile it as one small function."""
    return _set_xla_metadata is not None


def xla_metadata(**attributes: str) -> contextlib.AbstractContextManager[Any]:
    """Attach attributes to what is traced inside; nothing where this JAX cannot."""
    return contextlib.nullcontext() if _set_xla_metadata is None else _set_xla_metadata(**attributes)


def quick_compile(level: int = 1) -> dict[str, bool | str]:
    """XLA's options for programs of small arrays: half the time to compile on JAX 0.10, and as fast.

    What the variable XLA_FLAGS sets stays.

    Args:
        level: of optimisation; 0 takes half of that once more, for programs that run seldom or do little.
    """
    options: dict[str, bool | str] = {"xla_backend_optimization_level": str(level)}
    if jax.__version_info__ < (0, 11):
        options["xla_cpu_use_fusion_emitters"] = False
    flags = os.environ.get("XLA_FLAGS", "")
    return {name: value for name, value in options.items() if name not in flags}


def accelerators_exist() -> bool:
    """Whether this process has devices beside the CPU, on which a computation may run too."""
    return any(name != "cpu" for name in backends())


@contextlib.contextmanager
def in_double() -> Iterator[None]:
    """Double precision, on the CPU; and values at once, also in a function that is being traced."""
    with jax.enable_x64(True), contextlib.ExitStack() as stack:
        if accelerators_exist():
            stack.enter_context(jax.default_device(jax.local_devices(backend="cpu")[0]))
        # Only there: checks at run time, as diffrax makes them, do not work in it.
        if is_tracing() and is_traced(jnp.zeros(())):
            stack.enter_context(jax.ensure_compile_time_eval())
        yield


def batched_branches_transpose() -> bool:
    """Whether the linear part of `cond` under `vmap`, as the rule of a `custom_root` has it, can be transposed."""
    return jax.__version_info__ >= (0, 11)


def makes_an_array(frame: FrameType) -> bool:
    """Whether a frame that asks for `__jax_array__` is a function of JAX that needs an array of what it was given.

    The operators of JAX's arrays ask too. They hand over to the other operand where there is no such attribute.
    """
    module = str(frame.f_globals.get("__name__", ""))
    return module.startswith("jax.") and not module.endswith(".array_methods")


def any_of_batch(condition: jax.Array) -> jax.Array:
    """Whether a condition holds for any member of a batch: one truth value also under vmap."""
    from equinox.internal import unvmap_any

    return unvmap_any(condition)


def wrapped_terms() -> tuple[Any, Any]:
    """diffrax's term that turns time around, and its term of an adjoint."""
    from diffrax._term import AdjointTerm, WrapTerm

    return WrapTerm, AdjointTerm
