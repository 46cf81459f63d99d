"""Intermediate language to functions in memory."""

from __future__ import annotations

import ctypes
import ctypes.util
import threading
from typing import Any

from .code import Module
from .processor import Processor

__all__ = ["BuildError", "load", "target_machine"]

_LOCK = threading.Lock()

#: What was compiled stays in memory for as long as the process: XLA may call it at any time.
_ENGINES: list[Any] = []


class BuildError(Exception):
    """No machine code came of it; the message says why."""


def target_machine(processor: Processor) -> Any:
    """What LLVM writes for, in the code model of its JIT, where code and constants may lie anywhere.

    The small one wants them within 2 GB of each other, and LLVM ends the process where they are not: in one that has
    run for long free memory is farther apart than that.
    """
    import llvmlite.binding as llvm

    return llvm.Target.from_default_triple().create_target_machine(
        cpu=processor.name, features=processor.features, opt=2, reloc="pic", codemodel="jitdefault", jit=True
    )


def load(text: str, module: Module, names: tuple[str, ...]) -> dict[str, int]:
    """The addresses of functions.

    Raises:
        ImportError: llvmlite is not installed.
        BuildError: a function of the C library is missing, or LLVM refuses the text.
    """
    import llvmlite.binding as llvm

    with _LOCK:
        llvm.initialize_native_target()
        llvm.initialize_native_asmprinter()
        for symbol in sorted(module.library):
            llvm.add_symbol(symbol, _address(symbol))
        try:
            parsed = llvm.parse_assembly(text)
            parsed.verify()
            engine = llvm.create_mcjit_compiler(parsed, target_machine(module.processor))
            engine.finalize_object()
        except RuntimeError as error:
            raise BuildError(f"LLVM refuses it: {error}") from error
        _ENGINES.append(engine)
        found = {name: engine.get_function_address(name) for name in names}
        # The code stays; what it was made from takes several times its room.
        engine.remove_module(parsed)
        return found


def _address(symbol: str) -> int:
    """Of a function of the C library. LLVM ends the process where it finds none, so it is looked up before."""
    # Names of files are looked for, which takes time, only where the process itself has no such function.
    for name in (None, "m", "c"):
        try:
            function = getattr(ctypes.CDLL(name and ctypes.util.find_library(name)), symbol)
        except (AttributeError, OSError, TypeError):
            continue
        found = ctypes.cast(function, ctypes.c_void_p).value
        if found:
            return found
    raise BuildError(f"the C library has no {symbol}")
