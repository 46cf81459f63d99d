"""The function that XLA calls, by its typed foreign-function interface.

Structures and their offsets are those of `xla/ffi/api/c_api.h`, version 0.3, on machines with addresses of 64 bits.
The handler tells XLA for which version it is made; XLA refuses it where it does not know that one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .code import Module, addressed
from .rows import Array

__all__ = ["API", "write_handler"]

#: The version of the interface.
API = (0, 3)

#: XLA's numbers of the types, `XLA_FFI_DataType`.
_DATA_TYPES = {"double": 12, "float": 11, "i64": 5, "i32": 4, "i1": 1}

_BEGIN = """define ptr @handler(ptr %frame) #0 {{
entry:
%extension = load ptr, ptr %frame + 8
%plain = icmp eq ptr %extension, null
br i1 %plain, label %call, label %asked
asked:
%type = load i32, ptr %extension + 8
%describe = icmp eq i32 %type, 1
br i1 %describe, label %metadata, label %call
metadata:
%own = load ptr, ptr %extension + 24
store i32 {major}, ptr %own + 24
store i32 {minor}, ptr %own + 28
store i32 0, ptr %own + 32
ret ptr null
call:
%api = load ptr, ptr %frame + 16
%major = load i32, ptr %api + 32
%minor = load i32, ptr %api + 36
%same = icmp eq i32 %major, {major}
%recent = icmp sge i32 %minor, {minor}
%known = and i1 %same, %recent
br i1 %known, label %count, label %wrong.version
count:
%arguments.count = load i64, ptr %frame + 56
%results.count = load i64, ptr %frame + 96
%arguments.right = icmp eq i64 %arguments.count, {arguments}
%results.right = icmp eq i64 %results.count, {results}
%counts.right = and i1 %arguments.right, %results.right
br i1 %counts.right, label %buffers, label %wrong.count
buffers:
%arguments = load ptr, ptr %frame + 72
%results = load ptr, ptr %frame + 112
%table = alloca [{count} x ptr]
%first.at = load ptr, ptr %results
%first.dims = load ptr, ptr %first.at + 40
%rows = load i64, ptr %first.dims
br label %check.0
"""

_BUFFER = """check.{k}:
%slot.{k} = getelementptr ptr, ptr %{family}, i64 {place}
%buffer.{k} = load ptr, ptr %slot.{k}
%type.{k} = load i32, ptr %buffer.{k} + 16
%rank.{k} = load i64, ptr %buffer.{k} + 32
%type.right.{k} = icmp eq i32 %type.{k}, {type}
%rank.right.{k} = icmp eq i64 %rank.{k}, 2
%kind.{k} = and i1 %type.right.{k}, %rank.right.{k}
br i1 %kind.{k}, label %shape.{k}, label %wrong.{k}
shape.{k}:
%dims.{k} = load ptr, ptr %buffer.{k} + 40
%rows.{k} = load i64, ptr %dims.{k}
%size.{k} = load i64, ptr %dims.{k} + 8
%rows.right.{k} = icmp eq i64 %rows.{k}, %rows
%size.right.{k} = icmp eq i64 %size.{k}, {size}
%both.{k} = and i1 %rows.right.{k}, %size.right.{k}
br i1 %both.{k}, label %keep.{k}, label %wrong.{k}
keep.{k}:
%data.{k} = load ptr, ptr %buffer.{k} + 24
%entry.{k} = getelementptr ptr, ptr %table, i64 {k}
store ptr %data.{k}, ptr %entry.{k}
br label %check.{next}
"""

_END = """check.{count}:
%empty = icmp eq i64 %rows, 0
br i1 %empty, label %done, label %work
work:
call void @start(ptr %frame, ptr %table, i64 %rows, i64 {threads})
br label %done
done:
ret ptr null
"""

_ERROR = """{label}:
%error.{label} = call ptr @failed(ptr %api, ptr @message.{label})
ret ptr %error.{label}
"""

# Error code 3: an invalid argument.
_FAILED = """define internal ptr @failed(ptr %api, ptr %message) #0 {
%arguments = alloca [4 x i64]
store i64 28, ptr %arguments
store i64 0, ptr %arguments + 8
store ptr %message, ptr %arguments + 16
store i64 3, ptr %arguments + 24
%create = load ptr, ptr %api + 48
%error = call ptr %create(ptr %arguments)
ret ptr %error
}"""


def write_handler(module: Module, arguments: Sequence[Array], results: Sequence[Array], threads: int) -> None:
    """`handler(frame)`: checks the version, types and shapes (rows, entries), then computes all rows.

    Args:
        threads: the most to use.
    """
    count = len(arguments) + len(results)
    major, minor = API
    text = _BEGIN.format(major=major, minor=minor, arguments=len(arguments), results=len(results), count=count)
    messages = {
        "wrong.version": f"a kernel of twistax is made for version {major}.{minor} of XLA's foreign-function interface",
        "wrong.count": f"a kernel of twistax takes {len(arguments)} arguments and gives {len(results)} results",
    }
    families = [("argument", k, a) for k, a in enumerate(arguments)] + [("result", k, a) for k, a in enumerate(results)]
    for k, (family, place, array) in enumerate(families):
        kind = _DATA_TYPES[array.kind]
        text += _BUFFER.format(k=k, family=f"{family}s", place=place, type=kind, size=array.size, next=k + 1)
        expected = f"{np.dtype(array.dtype).name} of shape (rows, {array.size})"
        messages[f"wrong.{k}"] = f"a kernel of twistax expects {expected} as {family} {place}"
    text += _END.format(count=count, threads=threads)
    text += "".join(_ERROR.format(label=label) for label in messages)
    constants = [
        f'@message.{label} = private constant [{len(message) + 1} x i8] c"{message}\\00"'
        for label, message in messages.items()
    ]
    module.functions["failed"] = addressed(_FAILED)
    module.functions["handler"] = "\n".join([addressed(text) + "}", *constants])
