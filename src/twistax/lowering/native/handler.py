"""The function that XLA calls, `kernel.ll`: what differs from kernel to kernel is filled in here."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from pathlib import Path
from string import Template

import numpy as np

from .code import Module, addressed
from .rows import Array

__all__ = ["API", "write_handler"]

#: The version of the interface. XLA refuses a handler that is made for a version it does not know.
API = (0, 3)

#: XLA's numbers of the types, `XLA_FFI_DataType`.
_DATA_TYPES = {"double": 12, "float": 11, "i64": 5, "i32": 4, "i1": 1}

#: What is called of LLVM and of the C library.
_DECLARED = {
    "declare ptr @malloc(i64)",
    "declare void @free(ptr)",
    "declare i32 @sched_yield()",
    "declare void @llvm.memcpy.p0.p0.i64(ptr, ptr, i64, i1)",
    "declare i64 @llvm.umin.i64(i64, i64)",
}

_BUFFER = """check.{k}:
%right.{k} = call i1 @taken(ptr %{family}s, i64 {place}, i32 {type}, i64 %rows, i64 {size}, ptr %table, i64 {k})
br i1 %right.{k}, label %check.{next}, label %wrong.{k}"""

_ERROR = """{label}:
%error.{label} = call ptr @failed(ptr %api, ptr @message.{label})
ret ptr %error.{label}"""

_POINTER = """%p{k} = getelementptr ptr, ptr %table, i64 {k}
%{name} = load ptr, ptr %p{k}"""

_MOVED = """%{name}.place = mul i64 %row, {size}
%{name}.row = getelementptr {stored}, ptr %{name}, i64 %{name}.place"""


@functools.cache
def _template() -> Template:
    return Template(Path(__file__).with_name("kernel.ll").read_text())


def write_handler(module: Module, arrays: Mapping[str, Array], read: int, lanes: int, chunk: int, threads: int) -> None:
    """Adds `run(table, first, end)`, rows of the arrays in a table of pointers, and `handler(frame)`, all rows.

    Args:
        arrays: by what the tile calls them: those that are read, then the results.
        read: how many are read.
        lanes: rows of a tile.
        chunk: rows that a thread takes at a time, a multiple of `lanes`.
        threads: the most to use.
    """
    results = len(arrays) - read
    major, minor = API
    messages = {
        "wrong.version": f"a kernel of twistax is made for version {major}.{minor} of XLA's foreign-function interface",
        "wrong.count": f"a kernel of twistax takes {read} arguments and gives {results} results",
    }
    buffers = []
    for k, array in enumerate(arrays.values()):
        family, place = ("argument", k) if k < read else ("result", k - read)
        kind = _DATA_TYPES[array.kind]
        buffers.append(_BUFFER.format(k=k, family=family, place=place, type=kind, size=array.size, next=k + 1))
        expected = f"{np.dtype(array.dtype).name} of shape (rows, {array.size})"
        messages[f"wrong.{k}"] = f"a kernel of twistax expects {expected} as {family} {place}"
    constants = [
        f'@message.{label} = private constant [{len(message) + 1} x i8] c"{message}\\00"'
        for label, message in messages.items()
    ]
    text = _template().substitute(
        messages="\n".join(constants),
        pointers="\n".join(_POINTER.format(k=k, name=name) for k, name in enumerate(arrays)),
        moved="\n".join(_MOVED.format(name=name, size=a.size, stored=a.stored) for name, a in arrays.items()),
        rows="".join(f", ptr %{name}.row" for name in arrays),
        lanes=lanes,
        chunk=chunk,
        table=8 * len(arrays),
        job=32 + 8 * len(arrays),
        major=major,
        minor=minor,
        arguments=read,
        results=results,
        count=len(arrays),
        buffers="\n".join(buffers),
        threads=threads,
        errors="\n".join(_ERROR.format(label=label) for label in messages),
    )
    module.declarations |= _DECLARED
    module.library |= {"malloc", "free", "sched_yield"}
    module.functions["handler"] = addressed(text)
