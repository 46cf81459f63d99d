"""Strict settings for the whole suite: x64, strict dtype and rank promotion, checked shapes, one CPU device."""

import ctypes
import functools
import gc
import os
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import jaxtyping
import pytest
from beartype import beartype
from jaxtyping import install_import_hook

#: XLA's work on a program took over half of the suite's time, four fifths of it for speed that no test needs.
#: The variable, set to nothing, stands for the settings of users: the smoke tier runs with them.
FLAGS = [
    "--xla_backend_optimization_level=0",
    "--xla_llvm_disable_expensive_passes=true",
    "--xla_cpu_parallel_codegen_split_count=1",
]
if jax.__version_info__ < (0, 11):
    FLAGS.append("--xla_cpu_use_fusion_emitters=false")
os.environ.setdefault("XLA_FLAGS", " ".join(FLAGS))

# NumPy's threads wait by spinning, which takes the processor from the other worker: 6 % of its time in a profile.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# What a test compiles it compiles, whatever was run before.
os.environ["TWISTAX_CACHE"] = "off"

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")

# Programs of pages and examples, in processes of their own, begin with the same settings. Users have none of them.
if os.environ["XLA_FLAGS"]:
    os.environ["TWISTAX_BEGIN"] = str(Path(__file__).with_name("quick_jax.py"))

#: Their functions act on single scalars or equations, a hundred thousand times for a large system: checks would take
#: most of the time.
UNCHECKED = ("twistax.scalar.", "twistax.jax_inside")

#: Annotations of arrays, with shapes, stand here alone.
SHAPED = "twistax.groups."


def checked_modules() -> list[str]:
    """All modules but those. A package stands for all that is in it, so packages around them are left out too."""
    source = Path(__file__).parents[1] / "src"
    names = [".".join(path.relative_to(source).with_suffix("").parts) for path in (source / "twistax").rglob("*.py")]
    names = [name.removesuffix("__init__").removesuffix(".") for name in names]
    return [n for n in names if not any(own.startswith(f"{n}.") or n.startswith(own) for own in UNCHECKED)]


_jaxtyped = jaxtyping.jaxtyped


def checked(item: Any = None, **how: Any) -> Any:
    """A function that checks its arguments and its result by beartype, made when it is first called.

    jaxtyping checks shapes too and takes ten times as long, so that is left to functions which name shapes. Functions
    within functions, which are made again and again, are not checked.
    """
    if item is None:
        return functools.partial(checked, **how)
    if isinstance(item, type) or item.__module__.startswith(SHAPED):
        return _jaxtyped(item, **how)
    if "<locals>" in item.__qualname__ or not item.__annotations__:
        return item
    strict = None

    @functools.wraps(item)
    def call(*args: Any, **kwargs: Any) -> Any:
        nonlocal strict
        if jaxtyping.config.jaxtyping_disable:
            return item(*args, **kwargs)
        if strict is None:
            item.__annotations__ = {name: known(hint, item.__globals__) for name, hint in item.__annotations__.items()}
            strict = beartype(item)
        return strict(*args, **kwargs)

    return call


def known(hint: Any, names: dict[str, Any]) -> Any:
    """What an annotation stands for; anything where its module imports the name for the type checker alone."""
    try:
        return eval(hint, names) if isinstance(hint, str) else hint
    except NameError:
        return Any


# Must come before the first import of the package: it decorates every annotated function.
jaxtyping.jaxtyped = checked
install_import_hook(checked_modules(), "beartype.beartype")


import quick_jax  # noqa: E402, F401
from kernel_level import optimised  # noqa: E402, F401  imports the package, so it comes last


@pytest.fixture
def unchecked() -> Iterator[None]:
    """Users run without the type checker, which would speak before the package where an argument has a wrong type."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Marks the tiers that tiers.toml names. Names that are gone are told by test_architecture.py."""
    tiers = tomllib.loads((Path(__file__).parent / "tiers.toml").read_text())
    for item in items:
        name = item.nodeid.removeprefix("tests/")
        names = {name, name.partition("[")[0], name.partition("::")[0]}
        if item.get_closest_marker("slow"):
            continue
        if names & set(tiers["slow"]["tests"]):
            item.add_marker("slow")
            continue
        for tier in ("thorough", "smoke"):
            if names & set(tiers[tier]["tests"]):
                item.add_marker(tier)
    # What takes longest begins, so that no process works alone in the end.
    items.sort(key=lambda item: item.path.name not in tiers["first"]["files"])


def pytest_collection_finish() -> None:
    """Modules and tests stay to the end: no search for cycles has to pass through them again."""
    gc.collect()
    gc.freeze()


#: Megabytes that a worker may hold before what JAX keeps of earlier tests is dropped, and those it gets after that.
MEMORY, ROOM = 1250, 250

_limit = float(MEMORY)


def pytest_runtest_logfinish() -> None:
    """Between tests: JAX keeps each program and its machine code, 6 GB over the suite, and glibc what was freed."""
    global _limit
    if sys.platform != "linux" or resident() < _limit:
        return
    jax.clear_caches()
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    # Some of it stays: to drop the rest again and again would take the time of compiling it again and again.
    _limit = max(MEMORY, resident() + ROOM)


def resident() -> float:
    """Megabytes of this process in memory."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
