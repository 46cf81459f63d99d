"""The function that XLA calls through its typed foreign-function interface, `handler.ll`: checks, then the loop over
rows.

The parts that differ between kernels are filled in here.
"""

from __future__ import annotations

import functools
import time
from pathlib import Path
from string import Template

import numpy as np

from .code import Module, addressed
from .kernel_body import BatchFunction

#: The version of the interface. XLA refuses a handler that is made for a version it does not know.
API = (0, 3)

#: XLA's numbers of the types, `XLA_FFI_DataType`.
_DATA_TYPES = {"double": 12, "float": 11, "i64": 5, "i32": 4, "i1": 1}

#: What other threads cost on a loaded machine is at most about one part in so many of the time of all batches.
_SHARE = 16
#: The most ns that other threads of one batch are taken to have cost.
_MOST_LOST = 100_000_000

#: Declarations of functions of LLVM and of the C library.
_DECLARED = {
    "declare ptr @malloc(i64)",
    "declare void @free(ptr)",
    "declare i32 @sched_yield()",
    "declare i32 @clock_gettime(i32, ptr)",
    "declare void @llvm.memcpy.p0.p0.i64(ptr, ptr, i64, i1)",
    "declare i64 @llvm.umin.i64(i64, i64)",
    "declare i64 @llvm.umax.i64(i64, i64)",
}

_BUFFER = """%right.{k} = call i1 @taken(ptr %{family}s, i64 {place}, i1 {shared}, i32 {type},
 i64 %rows, i64 {size}, ptr %table, i64 {k})
br i1 %right.{k}, label %check.{next}, label %wrong.{k}"""

#: The entries of a long array: how many there are at each place, times the length, which is the first argument.
_LONG = """%count.at.{k} = load ptr, ptr %table
%count.{k} = load i32, ptr %count.at.{k}
%length.{k} = sext i32 %count.{k} to i64
%size.{k} = mul i64 %length.{k}, {size}"""

#: The stride of an array by rows: entries from one row to the next; by columns: from one entry of a row to the next.
_BY_ROWS = "%stride = select i1 %rows.same, i64 %size, i64 0"
_BY_COLUMNS = "%stride = select i1 %rows.same, i64 %rows, i64 1"

_ERROR = """{label}:
%error.{label} = call ptr @failed(ptr %api, ptr @message.{label})
ret ptr %error.{label}"""

_POINTER = """%p{k} = getelementptr ptr, ptr %table, i64 {k}
%{name} = load ptr, ptr %p{k}
%s{k} = getelementptr ptr, ptr %table, i64 {stride}
%{name}.stride = load i64, ptr %s{k}"""

_MOVED = """%{name}.place = mul i64 %row, %{name}.stride
%{name}.row = getelementptr {stored}, ptr %{name}, i64 %{name}.place"""


#: The same of an array on a device: as many as XLA says.
_LONG_THERE = """%slot.{k} = getelementptr ptr, ptr %{family}s, i64 {place}
%buffer.{k} = load ptr, ptr %slot.{k}
%dims.{k} = load ptr, ptr %buffer.{k} + 40
%size.{k} = load i64, ptr %dims.{k} + 8"""

_PASSED = """%value.{k} = getelementptr ptr, ptr %table, i64 {k}
%slot.{k} = getelementptr ptr, ptr %parameters, i64 {k}
store ptr %value.{k}, ptr %slot.{k}"""

_DIGIT = """%rest.{k} = urem i32 %{value}, 10
%digit.{k} = add i32 %rest.{k}, 48
%byte.{k} = trunc i32 %digit.{k} to i8
%place.of.{k} = getelementptr i8, ptr @message.launch, i64 {place}
store i8 %byte.{k}, ptr %place.of.{k}"""

_NOT_STARTED = "a kernel of twistax was not started: CUDA error 000"


@functools.cache
def _template(name: str) -> Template:
    return Template(Path(__file__).with_name(f"{name}.ll").read_text())


def write_host_handler(module: Module, body: BatchFunction, threads: int) -> None:
    """Add `run(table, first, end)`, which computes some rows of the arrays in a table, and `handler(frame)`, which
    computes all rows by several threads.
    """
    arrays = body.arrays
    text = _template("kernel").substitute(
        pointers="\n".join(_POINTER.format(k=k, name=name, stride=k + len(arrays)) for k, name in enumerate(arrays)),
        moved="\n".join(_MOVED.format(name=name, stored=a.stored) for name, a in arrays.items()),
        rows="".join(f", ptr %{name}.row, i64 %{name}.stride" for name in arrays),
        lanes=body.lanes,
        chunk=body.chunk,
        table=16 * len(arrays),
        job=32 + 16 * len(arrays),
        threads=threads,
        clock=getattr(time, "CLOCK_MONOTONIC", 1),  # Windows has neither the function nor kernels
        share=_SHARE,
        most=_MOST_LOST,
    )
    module.declarations |= _DECLARED
    module.library |= {"malloc", "free", "sched_yield", "clock_gettime"}
    module.functions["start"] = addressed(text)
    _write_handler(module, body, {}, long=_LONG, stride=_BY_ROWS, traits=0)


def write_device_handler(module: Module, body: BatchFunction, block: int) -> None:
    """Add `handler(frame)`, which launches this number of threads at a time on a device, one for each row."""
    count = 2 * len(body.arrays)
    end = len(_NOT_STARTED)
    digits = ("hundreds", end - 3), ("tens", end - 2), ("code", end - 1)
    text = _template("launch").substitute(
        parameters=count + 1,
        entries=count,
        count=len(body.arrays),
        passed="\n".join(_PASSED.format(k=k) for k in range(count)),
        block=block,
        last=block - 1,
        digits="\n".join(_DIGIT.format(k=k, value=value, place=place) for k, (value, place) in enumerate(digits)),
    )
    module.functions["start"] = addressed(text)
    # XLA may put it into a CUDA graph: it does nothing but start a kernel.
    _write_handler(module, body, {"launch": _NOT_STARTED}, long=_LONG_THERE, stride=_BY_COLUMNS, traits=1)


def _write_handler(
    module: Module, body: BatchFunction, messages: dict[str, str], long: str, stride: str, traits: int
) -> None:
    """Adds `handler(frame)`, which checks what comes and calls `start`.

    Args:
        messages: of errors that `start` gives.
        long: the text that counts the entries of a long array.
        stride: the text that computes the stride of an array.
        traits: what XLA may do with it, `XLA_FFI_Handler_TraitsBits`.
    """
    arrays, read, results = body.arrays, len(body.read), len(body.written)
    major, minor = API
    checks = {
        "wrong.version": f"a kernel of twistax is made for version {major}.{minor} of XLA's foreign-function interface",
        "wrong.count": f"a kernel of twistax takes {read} arguments and gives {results} results",
    }
    buffers = []
    for k, array in enumerate(arrays.values()):
        family, place = ("argument", k) if k < read else ("result", k - read)
        fields = {"k": k, "family": family, "place": place, "type": _DATA_TYPES[array.kind], "next": k + 1}
        size, words = (f"%size.{k}", f"length * {array.size}") if array.long else (str(array.size), str(array.size))
        buffers += [f"check.{k}:", *([long.format(**fields, size=array.size)] if array.long else [])]
        buffers.append(_BUFFER.format(**fields, size=size, shared="true" if k < read else "false"))
        expected = f"{np.dtype(array.dtype).name} of shape (rows, {words})"
        checks[f"wrong.{k}"] = f"a kernel of twistax expects {expected} as {family} {place}"
    constants = [
        f'@message.{label} = private global [{len(message) + 1} x i8] c"{message}\\00"'
        for label, message in (checks | messages).items()
    ]
    text = _template("handler").substitute(
        messages="\n".join(constants),
        major=major,
        minor=minor,
        traits=traits,
        arguments=read,
        results=results,
        count=len(arrays),
        entries=2 * len(arrays),
        buffers="\n".join(buffers),
        stride=stride,
        errors="\n".join(_ERROR.format(label=label) for label in checks),
    )
    module.functions["handler"] = addressed(text)


_PLACE = """define ptr @place.{k}(ptr %frame) #0 {{
%at = getelementptr ptr, ptr @places, i64 {k}
%kernel = load ptr, ptr %at
%gone = icmp eq ptr %kernel, null
br i1 %gone, label %none, label %there
there:
%found = tail call ptr %kernel(ptr %frame)
ret ptr %found
none:
%api = load ptr, ptr %frame + 16
%error = call ptr @failed(ptr %api, ptr @message)
ret ptr %error
}}"""


def write_slots(module: Module, count: int) -> list[str]:
    """Add handlers that call the kernels whose addresses are in the variable `places`; return their names."""
    message = "a kernel of twistax is called, and what it was compiled for is gone"
    failed = _template("handler").template.partition("define internal ptr @failed")
    module.functions["places"] = "\n".join(
        [
            f"@places = global [{count} x ptr] zeroinitializer",
            f'@message = private constant [{len(message) + 1} x i8] c"{message}\\00"',
            addressed("".join(failed[1:]).partition("}")[0] + "}"),
            *(addressed(_PLACE.format(k=k)) for k in range(count)),
        ]
    )
    return [f"place.{k}" for k in range(count)]
