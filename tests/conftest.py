"""Strict settings for the whole suite: x64, strict dtype and rank promotion, checked shapes, one CPU device."""

from collections.abc import Iterator

import jax
import jaxtyping
import pytest
from jaxtyping import install_import_hook

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")

# Must come before the first import of the package: it decorates every annotated function.
install_import_hook("twistax", "beartype.beartype")


@pytest.fixture
def unchecked() -> Iterator[None]:
    """Users run without the type checker, which would speak before the package where an argument has a wrong type."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)
