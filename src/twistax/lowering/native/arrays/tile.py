"""A function of small arrays: one body after the other, vectors within a body."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ....jax_inside import ClosedJaxpr
from ..code import Code, Module
from ..pieces import STACK
from ..rows import Array
from ..tile import RowFunction
from .memory import ALIGNED, View, address, native_type
from .reader import Reading


class ArrayTile(RowFunction):
    """The function of a jaxpr.

    Attributes:
        kernels: of the programs that it calls, which must live as long.
    Raises:
        NotNative: an argument or a result has a type that machine code has not.
    """

    def __init__(self, closed: ClosedJaxpr) -> None:
        arguments, results = _arrays(closed.jaxpr.invars), _arrays(closed.jaxpr.outvars)
        super().__init__(1, arguments, results, range(len(arguments)))
        self._closed = closed
        self.kernels: list[Any] = []

    def write(self, module: Module) -> None:
        """Adds the function.

        Raises:
            NotNative: something in the jaxpr has no native form.
        """
        reading = Reading(module)
        code = reading.code
        found = reading.read(self._closed, [_memory(f"%a{k}", array) for k, array in enumerate(self.arguments)])
        for k in self.written:
            code.copied(found[k], _memory(f"%r{k}", self.results[k]))
        self.kernels = code.kernels
        _add_memory(code.code, code.space.size)
        module.functions["tile"] = code.code.function(f"internal void @tile(i64 %last{self._heads('ptr noalias')})")


def _add_memory(code: Code, size: int) -> None:
    """Puts what gets memory in front, and what gives it back behind. Stacks of threads may be small."""
    body, code.lines[:] = list(code.lines), []
    if size <= STACK:
        code.lines.append(f"%arena = alloca [{max(size, 1)} x i8], align {ALIGNED}")
        code.lines += body
        return
    block = code.call("ptr", "malloc", ("i64", str(size + ALIGNED)))
    up = code.emit(f"sub i64 0, {code.emit(f'ptrtoint ptr {block} to i64')}")
    code.lines.append(f"%arena = getelementptr i8, ptr {block}, i64 {code.emit(f'and i64 {up}, {ALIGNED - 1}')}")
    code.lines += body
    code.call("void", "free", ("ptr", block))


def _arrays(variables: Sequence[Any]) -> list[Array]:
    return [Array(tuple(v.aval.shape), native_type(v)) for v in variables]


def _memory(base: str, array: Array) -> View:
    """An argument or a result, which is dense."""
    like = np.empty(array.shape, array.dtype)
    return View(base, address(like), like)
