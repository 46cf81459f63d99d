"""The backends whose functions run as native code, and their targets: this processor and CUDA devices."""

from __future__ import annotations

import concurrent.futures
import contextlib
import dataclasses
import functools
import importlib.metadata
import importlib.util
import os
import time
import weakref
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping
from typing import Any

import jax

from ....checks import instance, whole
from ....errors import ModelError
from ....jax_inside import ClosedJaxpr, backends
from ....progress import say_once
from ...array_primitive import KernelOfArrays, Kernels
from ...backends import (
    ANY_SIZE,
    MOST_STORED,
    XLA,
    Backend,
    Emission,
    Shapes,
    Step,
    StepCompiler,
    array_operations,
    is_pure,
    outweighs_memory,
    pure,
    variables,
)
from ...graph import TooLarge
from ...jax_primitive import Derived, call_program
from ...program import Rows, ScalarProgram
from ...small_call import joins_program
from ...walk import uncollected
from ..cuda.columns import joined, parts
from ..cuda.driver import driver
from ..cuda.kernel import CudaKernel
from ..cuda.ptx import libdevice
from .arrays.body import ArrayBody, array_form
from .code import NotNative
from .kernel import HostKernel, Kernel
from .kernel_body import KernelBody, native_form
from .machine_code import BuildError, Processor, installed
from .self_test import check_kernel
from .step_kernels import StepKernels
from .straight.body import Straight

#: An event of `jax.monitoring` for each kernel, with the seconds to make it or to read it from the cache.
KERNEL_EVENT = "/twistax/kernel"

_XLA, _LONG = XLA(), 5000  #: XLA takes many seconds to compile functions of more operations.
#: Native forms of programs, between the check that there is one and the first kernel.
_FORMS: weakref.WeakKeyDictionary[ScalarProgram, ScalarProgram] = weakref.WeakKeyDictionary()
_MISSING = "llvmlite is not installed"


# ---- targets ---------------------------------------------------------------------------------------------------------


class Target(ABC):
    """A platform."""

    @property
    @abstractmethod
    def present(self) -> bool:
        """Whether this process has such devices. Programs that are lowered for other platforms run by XLA."""

    @property
    @abstractmethod
    def note(self) -> str:
        """How native programs run here, for `explain`; empty on the processor."""

    def parts(self, program: ScalarProgram) -> list[ScalarProgram]:
        """Programs, each for some columns of the results, that are a kernel each."""
        return [program]

    @abstractmethod
    def kernel(
        self, kind: type[KernelBody], form: Any, more: tuple[Any, ...], single: bool, threads: int | None
    ) -> Kernel:
        """The kernel of a kernel body.

        Args:
            kind: the class of the body, which takes a program in native form, the lanes, and `more`.
            single: whether it is for one member.
            threads: of the processor, at most; None: all.
        Raises:
            ImportError, BuildError: llvmlite is not installed; it could not be compiled.
        """


class Host(Target):
    """This processor: it computes as many members at once as a vector has lanes."""

    present, note = True, ""

    def kernel(
        self, kind: type[KernelBody], form: Any, more: tuple[Any, ...], single: bool, threads: int | None
    ) -> Kernel:
        processor = Processor.host()
        return HostKernel(kind(form, 1 if single else processor.lanes(form.dtype), *more), processor, threads)


class Cuda(Target):
    """CUDA devices: a thread for each member."""

    @property
    def present(self) -> bool:
        return "cuda" in backends()

    @property
    def note(self) -> str:
        try:
            major, minor = driver().capability
        except BuildError as error:
            return f"as XLA has them on CUDA devices: {error}"
        rest = "" if libdevice() else ", but by XLA where they call the C library: libdevice.10.bc is not installed"
        return f"in threads on CUDA devices of capability {major}.{minor}{rest}"

    def parts(self, program: ScalarProgram) -> list[ScalarProgram]:
        return parts(native_form(program) if program.calls else program)

    def kernel(
        self, kind: type[KernelBody], form: Any, more: tuple[Any, ...], single: bool, threads: int | None
    ) -> Kernel:
        return CudaKernel(kind(form, 1, *more))


#: By the names that JAX has for platforms.
TARGETS: Mapping[str, Target] = {"cpu": Host(), "cuda": Cuda()}


def notes() -> str:
    """A text on the execution of native programs on the devices of this process."""
    return "".join(f"; {target.note}" for target in TARGETS.values() if target.present and target.note)


# ---- backends --------------------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class KernelRunner:
    """Runs programs as kernels.

    Attributes:
        least: calls with fewer operations are left to XLA.
        threads: the largest number of threads that share a large batch; None: as many as XLA has.
        alone: whether a program is a kernel also in what would be one small function without it.
    """

    least: int = 500
    threads: int | None = None
    alone: bool = False

    def prepare(self, program: ScalarProgram, single: bool, platform: str = "cpu") -> Rows | None:
        """The kernel of a program, for one member or for batches; None where it has no native form."""
        known = _FORMS.pop(program, program)
        try:
            # Members side by side have more in memory than a loop gains.
            is_known = known is not program and (single or not known.calls)
            form = known if is_known else native_form(program, products=single)
        except NotNative:
            return None
        first, *rest = TARGETS[platform].parts(form)
        built = functools.partial(self.built, Straight, more=(), single=single, platform=platform)
        kernel = built(first)
        if kernel is None or not rest:
            return kernel
        # The first is alone: with it the self-test calls JAX, whose settings are those of a thread.
        with concurrent.futures.ThreadPoolExecutor(min(len(rest), os.cpu_count() or 1)) as threads:
            kernels = [kernel, *(made for made in threads.map(built, rest) if made is not None)]
        return joined(kernels) if len(kernels) > len(rest) else None

    def without_kernel(self, function: Step, shapes: Shapes) -> str | None:
        """The reason why a function cannot be part of a kernel; None where it can."""
        if not installed():
            return None
        closed = pure(function, shapes, MOST_STORED)
        if closed is None or (not is_pure(closed) and self.arrays(closed, False) is None):
            return "it has effects, random keys or too many constants: pass weights as a tx.ParameterTree"
        try:
            if is_pure(closed):
                native_form(_XLA.scalarised(closed))
        except (NotNative, TooLarge) as error:
            return None if self.arrays(closed, False) else str(error).splitlines()[0]
        return None

    def arrays(self, closed: ClosedJaxpr, checked: bool, terminates: bool = False) -> KernelOfArrays | None:
        """A function of matrices with kernels that loop over their entries; None where it has no such form.

        Args:
            terminates: whether its `while` loops end for all arguments; else there is no such form of them.
        """

        def kernels(closed: ClosedJaxpr) -> Kernels | None:
            try:
                form = array_form(closed, checked, terminates)
            except (NotNative, TooLarge):
                return None
            operations = array_operations(closed.jaxpr).total()
            made = functools.lru_cache(lambda single: self.built(ArrayBody, form, (), single, "cpu"))
            # Members side by side take all branches, and no loop of unknown length.
            one_by_one = terminates and not {"while", "cond"}.isdisjoint(form.counts())
            return lambda rows, platform: (
                made(rows == 1 or one_by_one) if platform == "cpu" and operations * rows >= self.least else None
            )

        program = KernelOfArrays(closed, kernels, alone=True)
        return None if program.kernels is None else program

    def built(
        self, kind: type[KernelBody], form: Any, more: tuple[Any, ...], single: bool, platform: str
    ) -> Kernel | None:
        """A kernel that passed the self-test; None, with a warning, if there is none."""
        started, target = time.perf_counter(), TARGETS[platform]
        if not target.present:
            return None
        try:
            with uncollected():
                kernel = target.kernel(kind, form, more, single, self.threads)
                if not kernel.handle.checked:
                    check_kernel(kernel)
        except (ImportError, BuildError, jax.errors.JaxRuntimeError) as error:
            say_once(f"no native kernel, XLA compiles the function instead: {error}")
            return None
        jax.monitoring.record_event_duration_secs(KERNEL_EVENT, time.perf_counter() - started)
        return kernel


@dataclasses.dataclass(frozen=True)
class Native(Backend):
    """Executes functions as kernels: machine code of their scalar programs, compiled by LLVM in this process.

    Members of a batch run in vector lanes, or each in a thread of a CUDA device. Native
    needs llvmlite, which is installed with twistax. It runs calls, batches and derivatives of functions on the CPU and
    on CUDA devices, and steps of explicit methods, with all steps and saved rows in one kernel, and their derivatives.
    Other loops of integrators, other devices, and functions without a native form use the backend `scalars`.

    Attributes:
        scalars: the backend that builds the scalar programs of functions, and executes functions without a kernel.
        threads: the largest number of threads that share a large batch; None: the number of XLA's threads.
        least: calls with fewer scalar operations in the whole batch are executed by XLA; a kernel call takes some 100
            ns.

    Raises:
        ModelError: threads below one, or least below zero.
    """

    scalars: XLA = _XLA
    threads: int | None = None
    least: int = 500

    def __post_init__(self) -> None:
        if self.threads is not None:
            whole("Native: threads", self.threads, 1, ModelError)
        whole("Native: least", self.least, 0, ModelError)
        instance("Native: scalars", self.scalars, XLA, "tx.XLA(...)", ModelError)

    def __str__(self) -> str:
        with_it = f"llvmlite {importlib.metadata.version('llvmlite')}" if installed() else f"{_MISSING}: XLA"
        return f"{super().__str__()} ({with_it})"

    def emit(self, closed: ClosedJaxpr, fixed: Collection[int] = ()) -> Emission:
        try:
            program = self.scalars.scalarised(closed)
        except TooLarge:
            return self.whole(closed) or self.scalars.emit(closed, fixed)
        return self._native(program, lambda: self.scalars.emit(closed, fixed))

    def whole(self, closed: ClosedJaxpr) -> Emission | None:
        widest = max((v.aval.size for v in [*closed.jaxpr.constvars, *variables(closed.jaxpr)]), default=0)
        if widest <= self.widest or not installed() or not is_pure(closed, MOST_STORED):
            return None
        with contextlib.suppress(TooLarge, NotNative):
            if is_pure(closed):
                return self._native(self.scalars.scalarised(closed, moved=True))
        program = self.runner.arrays(closed, self.scalars.checked)
        if program is None:
            return None
        reason = f"native: loops over arrays, {array_operations(closed.jaxpr).total():,} operations"
        return Emission(lambda *a: call_program(program, *a), None, reason, loops=True)

    def derived(self, program: ScalarProgram) -> Derived:
        return self._kernels(program)[0] or Derived(program)

    def in_loops(self) -> Backend:
        return _InLoops(self.scalars, self.threads, self.least)

    def of_any_size(self) -> Backend:
        return dataclasses.replace(self, least=1, scalars=dataclasses.replace(self.scalars, least=1, widest=ANY_SIZE))

    def steps(self) -> StepCompiler:
        return StepKernels(self.scalars, self.runner)

    @property
    def widest(self) -> int:  # type: ignore[override]
        return self.scalars.widest

    @property
    def runner(self) -> KernelRunner:
        """Runs its programs."""
        return KernelRunner(self.least, self.threads)

    def _kernels(self, program: ScalarProgram) -> tuple[Derived | None, str]:
        """The program with its kernels, and a reason."""
        if not installed():
            self._say_missing()
            return None, _MISSING
        try:
            form = native_form(program, products=True)
        except NotNative as error:
            return None, str(error)
        if form is not program:  # which would hold itself
            _FORMS[program] = form
        if not form.operations:
            return Derived(program, None, self.runner), "numbers are moved, nothing is computed"
        reason = f"native: {form.operations} operations; as XLA has them where a call has fewer than {self.least}"
        return Derived(program, None, self.runner), reason + notes()

    def _native(self, program: ScalarProgram, otherwise: Callable[[], Emission] | None = None) -> Emission:
        derived, reason = self._kernels(program)
        if derived is None:
            if otherwise is None:
                raise NotNative
            emission = otherwise()
            return dataclasses.replace(emission, reason=f"{emission.reason}; not native: {reason}")
        program.graph.largest = ANY_SIZE
        return Emission(lambda *a: call_program(derived, *a), program, reason)

    def _say_missing(self) -> None:
        say_once("tx.Native needs llvmlite: pip install llvmlite; XLA compiles these functions instead")


@dataclasses.dataclass(frozen=True)
class _InLoops(Native):
    """The backend inside loops: `scalars`, and kernels for programs that take XLA long to compile."""

    def emit(self, closed: ClosedJaxpr, fixed: Collection[int] = ()) -> Emission:
        emission = self.scalars.emit(closed, fixed)
        if emission.program is None and not emission.few:
            return self.whole(closed) or emission
        if emission.program is None or emission.program.operations < _LONG or not installed():
            return emission
        return self._native(emission.program, lambda: emission)

    def in_loops(self) -> Backend:
        return self

    @property
    def runner(self) -> KernelRunner:
        return KernelRunner(self.least, self.threads, alone=True)


@dataclasses.dataclass(frozen=True)
class Auto(Native):
    """The backend of `backend="auto"`: `XLA`, with kernels for its scalar programs if llvmlite is installed.

    Attributes: as those of `Native`.
    """

    def __str__(self) -> str:
        kernels = f"{Native.__str__(Native())} for large functions, " if installed() else ""
        return f"auto = {kernels}{self.scalars}"

    def emit(self, closed: ClosedJaxpr, fixed: Collection[int] = ()) -> Emission:
        emission = self.scalars.emit(closed, fixed)
        if not installed():
            return emission
        if emission.program is None and not emission.few:
            return self.whole(closed) or emission
        if emission.program is None:
            return self._in_batches(closed, emission) if is_pure(closed) else emission
        return self._native(emission.program, lambda: emission)

    def _in_batches(self, closed: ClosedJaxpr, emission: Emission) -> Emission:
        """A function that runs as it is written alone, and as a kernel in batches."""

        def kernels(closed: ClosedJaxpr) -> Kernels | None:
            with contextlib.suppress(TooLarge):
                derived = self._kernels(self.scalars.scalarised(closed))[0] if outweighs_memory(closed.jaxpr) else None
                return None if derived is None else derived.kernel
            return None

        program = KernelOfArrays(closed, kernels)
        function = lambda *a: emission.function(*a) if joins_program() else call_program(program, *a)  # noqa: E731
        reason = f"{emission.reason}; batches of {self.least:,} operations and more are kernels"
        return dataclasses.replace(emission, function=function, reason=reason)

    def _say_missing(self) -> None:
        """No warning: the user did not ask for llvmlite."""
