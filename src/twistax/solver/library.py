"""The functions of the core in memory, compiled once for each processor; the kernel cache stores the result."""

from __future__ import annotations

import ctypes
import functools
import hashlib

import jax

from ..errors import ModelError
from ..scalar import kernel_cache as cache
from ..scalar.targets.llvm.machine_code import MachineCode, Processor, compiled, load, written_by
from .sources import fingerprint
from .text import kept_text

#: What the machine code calls of the C library.
_C_LIBRARY = ("log", "log10", "memcpy", "memset", "pow", "sched_yield", "time")

_VOID_POINTER = ctypes.c_void_p

_NAMES = (
    *("twx_workspace_size", "twx_solve", "twx_phase_work", "twx_phase_scratch", "twx_phase_states"),
    *("twx_qp_workspace_size", "twx_qp_solve"),
    *("twx_form_memory", "twx_solve_members", "twx_linearised_members"),
    "twx_squares_workspace",
)

#: Functions that XLA calls, by the targets that they are registered as.
_HANDLERS = ("twx_solve_handler", "twx_linearised_handler", "twx_squares_handler")

#: Functions of a transcribed problem, by what `StageFunctions` calls them.
_TRANSCRIBED = ("values", "jacobians", "hessians", "retract")


class Library:
    """The core's functions for ctypes. They release Python's global lock, so that threads solve in parallel.

    Attributes:
        workspace_size: numbers of so many bytes that a problem needs.
        solve: see core.h.
        phase_work, phase_scratch: doubles that a phase needs, for its functions and for their derivatives.
        phase_states: where a substep ends in the last integration.
        transcribed: addresses of the functions of a transcribed problem, see transcription.h.
        qp_workspace_size, qp_solve: the same of a dense quadratic program, see qp.h.
        form_memory, solve_members, linearised_members: of members of a batch, see members.h.
        squares_workspace: doubles that a least-squares problem needs, see squares.h.
        targets: what `jax.ffi.ffi_call` calls the solve and the linearisation of a batch, and its least squares.
    """

    def __init__(self, code: MachineCode) -> None:
        self._code = code  # the memory of the functions
        size, solve, work, scratch, states, qp_size, qp_solve, *members = (code.addresses[name] for name in _NAMES)
        self.workspace_size = ctypes.CFUNCTYPE(ctypes.c_size_t, _VOID_POINTER, ctypes.c_size_t)(size)
        self.phase_work = ctypes.CFUNCTYPE(ctypes.c_size_t, _VOID_POINTER)(work)
        self.phase_scratch = ctypes.CFUNCTYPE(ctypes.c_size_t, _VOID_POINTER)(scratch)
        self.phase_states = ctypes.CFUNCTYPE(None, _VOID_POINTER, ctypes.c_int32, _VOID_POINTER)(states)
        self.transcribed = {name: code.addresses[f"twx_transcribed_{name}"] for name in _TRANSCRIBED}
        self.solve = ctypes.CFUNCTYPE(ctypes.c_int32, *[_VOID_POINTER] * 6)(solve)
        self.qp_workspace_size = ctypes.CFUNCTYPE(ctypes.c_size_t, _VOID_POINTER)(qp_size)
        self.qp_solve = ctypes.CFUNCTYPE(ctypes.c_int32, *[_VOID_POINTER] * 5)(qp_solve)
        count, long, pointer = ctypes.c_int32, ctypes.c_int64, _VOID_POINTER
        self.form_memory = ctypes.CFUNCTYPE(ctypes.c_size_t, pointer)(members[0])
        self.solve_members = ctypes.CFUNCTYPE(None, pointer, long, *[pointer] * 3)(members[1])
        self.linearised_members = ctypes.CFUNCTYPE(count, pointer, long, long, *[pointer] * 3)(members[2])
        self.squares_workspace = ctypes.CFUNCTYPE(ctypes.c_size_t, pointer)(members[3])

    @functools.cached_property
    def targets(self) -> tuple[str, str, str]:
        # XLA keeps a target until the process ends, and registers a name once.
        targets = []
        for name in _HANDLERS:
            target = f"twistax_{name}_{fingerprint()[:16]}"
            handler = ctypes.CFUNCTYPE(_VOID_POINTER, _VOID_POINTER)(self._code.addresses[name])
            jax.ffi.register_ffi_target(target, jax.ffi.pycapsule(handler), platform="cpu")
            targets.append(target)
        return targets[0], targets[1], targets[2]


@functools.cache
def library() -> Library:
    """The core, compiled for this processor.

    Raises:
        ModelError: llvmlite is not installed.
    """
    try:
        processor = Processor.host()
    except ImportError as error:
        raise ModelError("the solver needs llvmlite, which is not installed\n  fix: pip install llvmlite") from error
    text = kept_text()
    key = "core_" + hashlib.sha256((written_by(processor) + text).encode()).hexdigest()
    code = cache.kept(key)
    if code is None:
        code = compiled(text, processor)
        cache.keep(key, code)
    names = [*_NAMES, *_HANDLERS, *(f"twx_transcribed_{name}" for name in _TRANSCRIBED)]
    return Library(load(code, _C_LIBRARY, processor, names))
