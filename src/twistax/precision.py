"""Numbers that are computed at once and in double precision, whatever surrounds them."""

import contextlib
from collections.abc import Iterator

import jax


@contextlib.contextmanager
def in_double() -> Iterator[None]:
    """Double precision, and values at once, in a function that is being traced too."""
    with jax.enable_x64(True), jax.ensure_compile_time_eval():
        yield
