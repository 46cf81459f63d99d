"""A kernel body with one lane as a kernel for CUDA devices: a thread for each row, in PTX, which the driver assembles.

PTX for a compute capability runs on all devices with that one or a higher one (NVIDIA, PTX ISA, section 2).
"""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ..llvm.code import Module
from ..llvm.kernel_body import BatchFunction
from ..llvm.machine_code import BuildError, Processor, compiling

#: What the entry of the kernel is called.
ENTRY = "kernel"

_TRIPLE = "nvptx64-nvidia-cuda"
#: The version of PTX of CUDA 12.0, and the highest capability that it knows.
_VERSION, _HIGHEST = "+ptx80", (9, 0)

_INDICES = ("ctaid", "ntid", "tid")
_ENTRY = """define ptx_kernel void @{name}({heads}, i64 %rows) {{
entry:
%block = call i32 @llvm.nvvm.read.ptx.sreg.ctaid.x()
%threads = call i32 @llvm.nvvm.read.ptx.sreg.ntid.x()
%thread = call i32 @llvm.nvvm.read.ptx.sreg.tid.x()
%before = mul i32 %block, %threads
%index = add i32 %before, %thread
%row = zext i32 %index to i64
%inside = icmp ult i64 %row, %rows
br i1 %inside, label %go, label %done
go:
{rows}
call void @tile(i64 0{passed})
br label %done
done:
ret void
}}"""

#: The row of a thread, as a pointer that LLVM knows to be one to global memory. Arrays are stored by columns, so that
#: the threads of a warp read neighbouring entries; a row that all threads share has the stride one.
_ROW = """%{name}.global = addrspacecast ptr %{name} to ptr addrspace(1)
%{name}.all = icmp eq i64 %{name}.stride, %rows
%{name}.place = select i1 %{name}.all, i64 %row, i64 0
%{name}.there = getelementptr {stored}, ptr addrspace(1) %{name}.global, i64 %{name}.place
%{name}.row = addrspacecast ptr addrspace(1) %{name}.there to ptr"""


def device(capability: tuple[int, int]) -> Processor:
    """The devices with a compute capability, or with a higher one."""
    major, minor = min(capability, _HIGHEST)
    return Processor(f"sm_{major}{minor}", _VERSION, 64, True, False, _TRIPLE)


def write_kernel(module: Module, body: BatchFunction) -> None:
    """Add a kernel body with one lane, and its kernel, which takes pointers to all arrays, their strides and the number
    of rows.
    """
    module.by_columns = True
    body.write(module)
    # The kernel body becomes part of the kernel, where LLVM sees to what memory its pointers point.
    module.functions["tile"] = module.functions["tile"].replace(" #0 {", " alwaysinline nounwind {")
    module.declarations |= {f"declare i32 @llvm.nvvm.read.ptx.sreg.{name}.x()" for name in _INDICES}
    names = list(body.arrays)
    module.functions[ENTRY] = _ENTRY.format(
        name=ENTRY,
        heads=", ".join([f"ptr noalias %{name}" for name in names] + [f"i64 %{name}.stride" for name in names]),
        rows="\n".join(_ROW.format(name=name, stored=array.stored) for name, array in body.arrays.items()),
        passed="".join(f", ptr %{name}.row, i64 %{name}.stride" for name in names),
    )


def assembled(module: Module, text: str, loops: bool = True) -> str:
    """The PTX of a module's text.

    Args:
        loops: it has some. In straight code LLVM's passes find next to nothing, and take half of the time.
    Raises:
        ImportError: llvmlite is not installed.
        BuildError: LLVM refuses the text, or has no such target; a function of the C library has no counterpart.
    """
    import llvmlite.binding as llvm

    for symbol in module.library:
        text = re.sub(rf"@{symbol}\b", f"@__nv_{symbol}", text)
    with compiling(in_order=True):  # the assembler of PTX has a scheduler
        llvm.initialize_all_targets()
        llvm.initialize_all_asmprinters()
        try:
            machine = llvm.Target.from_triple(_TRIPLE).create_target_machine(
                cpu=module.processor.name, features=module.processor.features, opt=3
            )
            context = llvm.create_context()
            head = f'target datalayout = "{machine.target_data}"\ntarget triple = "{_TRIPLE}"\n'
            parsed = llvm.parse_assembly(head + text, context)
            parsed.verify()
            if module.library:
                _link_library(parsed, context, machine)
            passes = llvm.create_pass_builder(
                machine, llvm.create_pipeline_tuning_options(speed_level=3 if loops else 0)
            )
            passes.getModulePassManager().run(parsed, passes)
            code: str = machine.emit_assembly(parsed)
        except RuntimeError as error:
            raise BuildError(f"LLVM rejects it: {error}") from error
    return code


def _link_library(parsed: Any, context: Any, machine: Any) -> None:
    """Add the functions of CUDA's library of mathematics that a module calls."""
    import llvmlite.binding as llvm

    path = libdevice()
    wanted = sorted(f.name for f in parsed.functions if f.is_declaration and f.name.startswith("__nv_"))
    if path is None:
        called = ", ".join(name.removeprefix("__nv_") for name in wanted)
        raise BuildError(f"it calls {called}; CUDA's libdevice.10.bc, which has them, is not installed")
    library = llvm.parse_bitcode(_of_library(path, tuple(wanted), machine), context)
    library.triple, library.data_layout = parsed.triple, parsed.data_layout
    defined = {f.name for f in parsed.functions if not f.is_declaration}
    parsed.link_in(library)
    for function in parsed.functions:
        if function.is_declaration and function.name in wanted:
            raise BuildError(f"CUDA's libdevice.10.bc has no {function.name.removeprefix('__nv_')}")
        if not function.is_declaration and function.name not in defined:
            function.linkage = "internal"


#: The parts of the library that were needed, as bitcode: reading all of it takes longer than compiling a small kernel.
_PARTS: dict[tuple[Path, tuple[str, ...]], bytes] = {}


def _of_library(path: Path, names: tuple[str, ...], machine: Any) -> bytes:
    """The functions of the library with these names, and what they call."""
    import llvmlite.binding as llvm

    if (path, names) not in _PARTS:
        library = llvm.parse_bitcode(path.read_bytes(), llvm.create_context())
        for function in library.functions:
            if not function.is_declaration and function.name not in names:
                function.linkage = "internal"
        passes = llvm.create_new_module_pass_manager()
        passes.add_global_dead_code_eliminate_pass()
        passes.run(library, llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options()))
        _PARTS[path, names] = library.as_bitcode()
    return _PARTS[path, names]


def libdevice() -> Path | None:
    """CUDA's device library of mathematical functions, from JAX's wheels or a toolkit; None if there is none."""
    return next((path for path in _libdevices() if path.is_file()), None)


def _libdevices() -> Iterator[Path]:
    name = Path("nvvm", "libdevice", "libdevice.10.bc")
    spec = importlib.util.find_spec("nvidia")
    for folder in (spec and spec.submodule_search_locations) or ():
        yield from sorted(Path(folder).glob(f"*/{name}"))
    for variable in ("CUDA_HOME", "CUDA_PATH"):
        if variable in os.environ:
            yield Path(os.environ[variable], name)
    compiler = shutil.which("nvcc")
    if compiler:
        yield Path(compiler).resolve().parent.parent / name
    yield Path("/usr/local/cuda", name)
