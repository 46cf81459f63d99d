"""Strict settings for the whole suite: x64, strict dtype and rank promotion, checked shapes, one CPU device."""

import gc
from collections.abc import Iterator
from pathlib import Path

import jax
import jaxtyping
import pytest
from jaxtyping import install_import_hook

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")

# Traced programs are millions of objects: looking through them for cycles took an eighth of the suite's time.
gc.set_threshold(50_000, 20, 20)

#: Their functions act on single scalars, a hundred thousand times for a large system: checks would take most of it.
UNCHECKED = ("twistax.lowering.scalar.", "twistax.lowering.native.")


def checked_modules() -> list[str]:
    """All modules but those. A package stands for all that is in it, so packages around them are left out too."""
    source = Path(__file__).parents[1] / "src"
    names = [".".join(path.relative_to(source).with_suffix("").parts) for path in (source / "twistax").rglob("*.py")]
    names = [name.removesuffix("__init__").removesuffix(".") for name in names]
    return [n for n in names if not any(own.startswith(f"{n}.") or n.startswith(own) for own in UNCHECKED)]


# Must come before the first import of the package: it decorates every annotated function.
install_import_hook(checked_modules(), "beartype.beartype")


@pytest.fixture
def unchecked() -> Iterator[None]:
    """Users run without the type checker, which would speak before the package where an argument has a wrong type."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)
