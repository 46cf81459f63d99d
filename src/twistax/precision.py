"""Numbers that are computed at once and in double precision, whatever surrounds them."""

import contextlib
from collections.abc import Iterator

import jax
import jax.numpy as jnp

from .jax_inside import is_traced, is_tracing


@contextlib.contextmanager
def in_double() -> Iterator[None]:
    """Double precision; and values at once, also in a function that is being traced."""
    with jax.enable_x64(True), contextlib.ExitStack() as stack:
        # Only there: checks at run time, as diffrax makes them, do not work in it.
        if is_tracing() and is_traced(jnp.zeros(())):
            stack.enter_context(jax.ensure_compile_time_eval())
        yield
