"""The function that XLA calls, by its typed foreign-function interface.

Structures and their offsets are those of `xla/ffi/api/c_api.h`, version 0.3, on machines with addresses of 64 bits.
The handler tells XLA for which version it is made; XLA refuses it where it does not know that one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .code import Module
from .rows import Array

__all__ = ["API", "write_handler"]

#: The version of the interface.
API = (0, 3)

#: XLA's numbers of the types, `XLA_FFI_DataType`.
_DATA_TYPES = {"double": 12, "float": 11, "i64": 5, "i32": 4, "i1": 1}

_BEGIN = """define ptr @handler(ptr %frame) #0 {{
entry:
%extension.at = getelementptr i8, ptr %frame, i64 8
%extension = load ptr, ptr %extension.at
%plain = icmp eq ptr %extension, null
br i1 %plain, label %call, label %asked
asked:
%type.at = getelementptr i8, ptr %extension, i64 8
%type = load i32, ptr %type.at
%describe = icmp eq i32 %type, 1
br i1 %describe, label %metadata, label %call
metadata:
%metadata.at = getelementptr i8, ptr %extension, i64 24
%own = load ptr, ptr %metadata.at
%major.out = getelementptr i8, ptr %own, i64 24
store i32 {major}, ptr %major.out
%minor.out = getelementptr i8, ptr %own, i64 28
store i32 {minor}, ptr %minor.out
%traits = getelementptr i8, ptr %own, i64 32
store i32 0, ptr %traits
ret ptr null
call:
%api.at = getelementptr i8, ptr %frame, i64 16
%api = load ptr, ptr %api.at
%major.at = getelementptr i8, ptr %api, i64 32
%major = load i32, ptr %major.at
%minor.at = getelementptr i8, ptr %api, i64 36
%minor = load i32, ptr %minor.at
%same = icmp eq i32 %major, {major}
%recent = icmp sge i32 %minor, {minor}
%known = and i1 %same, %recent
br i1 %known, label %count, label %wrong.version
count:
%arguments.count.at = getelementptr i8, ptr %frame, i64 56
%arguments.count = load i64, ptr %arguments.count.at
%results.count.at = getelementptr i8, ptr %frame, i64 96
%results.count = load i64, ptr %results.count.at
%arguments.right = icmp eq i64 %arguments.count, {arguments}
%results.right = icmp eq i64 %results.count, {results}
%counts.right = and i1 %arguments.right, %results.right
br i1 %counts.right, label %buffers, label %wrong.count
buffers:
%arguments.at = getelementptr i8, ptr %frame, i64 72
%arguments = load ptr, ptr %arguments.at
%results.at = getelementptr i8, ptr %frame, i64 112
%results = load ptr, ptr %results.at
%table = alloca [{count} x ptr]
%first.at = load ptr, ptr %results
%first.dims.at = getelementptr i8, ptr %first.at, i64 40
%first.dims = load ptr, ptr %first.dims.at
%rows = load i64, ptr %first.dims
br label %check.0
"""

_BUFFER = """check.{k}:
%slot.{k} = getelementptr ptr, ptr %{family}, i64 {place}
%buffer.{k} = load ptr, ptr %slot.{k}
%type.{k}.at = getelementptr i8, ptr %buffer.{k}, i64 16
%type.{k} = load i32, ptr %type.{k}.at
%rank.{k}.at = getelementptr i8, ptr %buffer.{k}, i64 32
%rank.{k} = load i64, ptr %rank.{k}.at
%type.right.{k} = icmp eq i32 %type.{k}, {type}
%rank.right.{k} = icmp eq i64 %rank.{k}, 2
%kind.{k} = and i1 %type.right.{k}, %rank.right.{k}
br i1 %kind.{k}, label %shape.{k}, label %wrong.{k}
shape.{k}:
%dims.{k}.at = getelementptr i8, ptr %buffer.{k}, i64 40
%dims.{k} = load ptr, ptr %dims.{k}.at
%rows.{k} = load i64, ptr %dims.{k}
%size.{k}.at = getelementptr i64, ptr %dims.{k}, i64 1
%size.{k} = load i64, ptr %size.{k}.at
%rows.right.{k} = icmp eq i64 %rows.{k}, %rows
%size.right.{k} = icmp eq i64 %size.{k}, {size}
%both.{k} = and i1 %rows.right.{k}, %size.right.{k}
br i1 %both.{k}, label %keep.{k}, label %wrong.{k}
keep.{k}:
%data.{k}.at = getelementptr i8, ptr %buffer.{k}, i64 24
%data.{k} = load ptr, ptr %data.{k}.at
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
%extension = getelementptr i64, ptr %arguments, i64 1
store i64 0, ptr %extension
%message.at = getelementptr i64, ptr %arguments, i64 2
store ptr %message, ptr %message.at
%code.at = getelementptr i64, ptr %arguments, i64 3
store i64 3, ptr %code.at
%create.at = getelementptr i8, ptr %api, i64 48
%create = load ptr, ptr %create.at
%error = call ptr %create(ptr %arguments)
ret ptr %error
}"""


def write_handler(module: Module, arguments: Sequence[Array], results: Sequence[Array], threads: int) -> None:
    """`handler(frame)`: checks the version, types and shapes (rows, entries), then works out all rows.

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
    module.functions["failed"] = _FAILED
    module.functions["handler"] = "\n".join([text + "}", *constants])
