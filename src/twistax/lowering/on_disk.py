"""What XLA compiled, on disk beside kernels, for the next process."""

from __future__ import annotations

import contextlib
import hashlib
import os
from typing import Any, NamedTuple

import jax

from ..jax_inside import deserialize_and_load, jax_versions, quick_compile, serialize
from .native import cache
from .native.backend import installed
from .native.machine_code import Processor, written_by


class _Loaded(NamedTuple):
    """What was read from the disk; and its program, which keeps the kernels that it calls."""

    code: Any
    program: Any

    def __call__(self, *arguments: Any) -> Any:
        return self.code(*arguments)


def compiled(program: Any, lowered: Any, level: int) -> Any:
    """A program that JAX traced and lowered, compiled by XLA as `quick_compile(level)` says, or read from the disk.

    Its text says which file is its own; kernels that it calls were made as it was lowered. Only with llvmlite, which
    knows the processor, and on one device, the CPU; not where JAX has dropped arguments: `jit(..., keep_unused=True)`.
    """
    text = lowered.as_text()
    # The text does not say which arguments JAX has dropped, and the address of a callback is that of this process.
    whole = text.split("@main(", 1)[1].split("\n", 1)[0].count("%arg") == len(jax.tree.leaves(lowered.args_info))
    alone = jax.default_backend() == "cpu" and jax.local_device_count() == 1
    if not (installed() and alone and whole) or "callback" in text:
        return lowered.compile()
    settings = (*sorted(quick_compile(level).items()), os.environ.get("XLA_FLAGS"), *jax_versions())
    key = hashlib.sha256(repr((text, settings, written_by(Processor.host()))).encode()).hexdigest()
    content = cache.kept(key)
    if content is not None:
        try:
            return _Loaded(deserialize_and_load(content, lowered.in_tree, lowered.out_tree), program)
        except Exception:  # whatever JAX or XLA have against it
            pass
    found = lowered.compile()
    with contextlib.suppress(Exception):  # what holds more than code is not kept
        cache.keep(key, serialize(found)[0])
    return found
