"""The emitter whose functions run as machine code of their own on the CPU."""

from __future__ import annotations

import dataclasses
import importlib.util
import warnings
from collections.abc import Callable, Collection

import jax
from jax.extend.core import ClosedJaxpr

from ...errors import ModelError
from ..emitters import XLA, Emission, Emitter
from ..scalar.graph import TooLarge
from ..scalar.primitive import Backend, Derived, call_program
from ..scalar.program import ScalarProgram
from .code import NotNative
from .kernel import Kernel
from .machine_code import BuildError
from .processor import Processor
from .self_test import check_kernel
from .tile import Straight, native_form

__all__ = ["Native", "installed"]

_XLA = XLA()

#: Messages that were given, each once for a process.
_SAID: set[str] = set()


def installed() -> bool:
    """Whether llvmlite is there."""
    return importlib.util.find_spec("llvmlite") is not None


@dataclasses.dataclass(frozen=True)
class Native(Emitter, Backend):
    """Scalars as machine code for this processor, compiled by LLVM in this process, bodies side by side in vectors.

    Needs llvmlite, `pip install "twistax[native]"`. For calls, batches and derivatives of functions on the CPU; the
    loops of integrators, other devices, and whatever has no native form run as `scalars` does.

    Attributes:
        scalars: how functions are written out, and what runs them where no kernel does. Its `least` does not count.
        threads: the most that a large batch is shared between; None: as many as XLA has.
        least: calls with fewer operations on scalars, those of all bodies together, run as XLA has them.

    Raises:
        ModelError: threads or least is not positive.
    """

    scalars: XLA = _XLA
    threads: int | None = None
    least: int = 0

    def __post_init__(self) -> None:
        if self.threads is not None and self.threads < 1:
            raise ModelError(f"Native expects threads of at least 1, or None for all, got {self.threads}")
        if self.least < 0:
            raise ModelError(f"Native expects least not below zero, got {self.least}")

    # ---- the emitter ---------------------------------------------------------------------------------------------

    def emit(self, closed: ClosedJaxpr, fixed: Collection[int] = ()) -> Emission:
        try:
            program = self.scalars.written_out(closed)
        except TooLarge as error:
            return self._otherwise(closed, fixed, str(error).splitlines()[0])
        derived, reason = self._kernels(program)
        if derived is None:
            return self._otherwise(closed, fixed, reason)
        return Emission(lambda *a: call_program(derived, *a), program, reason)

    def derived(self, program: ScalarProgram) -> Derived:
        return self._kernels(program)[0] or Derived(program)

    def in_loops(self) -> Emitter:
        return self.scalars

    def _kernels(self, program: ScalarProgram) -> tuple[Derived | None, str]:
        """The program with what runs it, and why."""
        if not installed():
            _say("tx.Native needs llvmlite: pip install 'twistax[native]'; XLA compiles these functions instead")
            return None, "llvmlite is not installed"
        try:
            form = native_form(program)
        except NotNative as error:
            return None, str(error)
        return Derived(program, None, self), f"native: {form.operations} operations"

    def _otherwise(self, closed: ClosedJaxpr, fixed: Collection[int], reason: str) -> Emission:
        found = self.scalars.emit(closed, fixed)
        return dataclasses.replace(found, reason=f"{found.reason}; not native: {reason}")

    # ---- the backend ---------------------------------------------------------------------------------------------

    def worthwhile(self, program: ScalarProgram, rows: int) -> bool:
        return program.operations * rows >= self.least

    def prepare(self, program: ScalarProgram) -> Callable[..., list[jax.Array]] | None:
        try:
            form, processor = native_form(program), Processor.host()
            kernel = Kernel(Straight(form, processor.lanes(form.graph.dtype)), processor, self.threads)
            check_kernel(kernel)
        except NotNative:
            return None
        except (ImportError, BuildError, jax.errors.JaxRuntimeError) as error:
            _say(f"no native kernel, XLA compiles the function instead: {error}")
            return None
        return kernel


def _say(message: str) -> None:
    if message not in _SAID:
        _SAID.add(message)
        warnings.warn(message, RuntimeWarning, stacklevel=2)
