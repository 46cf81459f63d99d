"""Functions of vectors as kernels that the core calls for batches of rows, with first and second derivatives."""

from __future__ import annotations

import contextlib
import ctypes
import enum
import functools
import math
import threading
import time
from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias

import jax
import numpy as np
from numpy import ndarray as Array

from ..groups import Product
from ..jax_inside import ClosedJaxpr, in_double, jaxpr_as_fun
from ..scalar.backends import ANY_SIZE, XLA
from ..scalar.program import ScalarProgram
from ..scalar.reader import computed_before
from ..scalar.targets.llvm.backend import KERNEL_EVENT
from ..scalar.targets.llvm.code import NotNative
from ..scalar.targets.llvm.kernel import HostKernel
from ..scalar.targets.llvm.kernel_body import NATIVE_LIMITS, by_numpy, native_form
from ..scalar.targets.llvm.machine_code import BuildError, Processor
from ..scalar.targets.llvm.self_test import check_kernel
from ..scalar.targets.llvm.straight.body import Straight
from ..scalar.walk import uncollected
from ..system.functions import Cache
from ..system.hessian import REFUSALS, WeightedHessian, hessian_in_arrays
from ..system.jacobian import Differentiated, RateJacobian


class Argument(enum.IntEnum):
    """The arguments of a kernel, in the layout of `twx_argument` in transcription.h. Kernels in C have the last one."""

    Z = 0
    SHARE = 1
    BASE = 2
    TARGET = 3
    DATA = 4
    NUMBERS = 5
    WEIGHTS = 6
    ROW = 7
    PHASE = 8
    SHARED = 9


class KernelStructure(ctypes.Structure):
    """`twx_kernel`."""

    _fields_ = [
        ("run", ctypes.c_void_p),
        ("reads", ctypes.c_int32),
        ("argument", ctypes.c_int32 * len(Argument)),
        ("numbers", ctypes.c_void_p),
    ]


class SmoothStructure(ctypes.Structure):
    """`twx_smooth`."""

    _fields_ = [
        *((name, KernelStructure) for name in ("value", "slopes", "bends", "shared")),
        ("rows", ctypes.c_int32),
        ("shared_width", ctypes.c_int32),
    ]


class ScalarForm(NamedTuple):
    """A kernel as a program of scalars, for writers of other languages."""

    program: ScalarProgram
    arguments: Sequence[Argument]
    numbers: Array


class BatchKernel:
    """A function of vectors in the form that the core calls: one row of each argument for a row of the result.

    Args:
        numbers: those of `Argument.NUMBERS`, which stay.

    Attributes:
        structure: its address, arguments and numbers, for the core.
        owner: what the address belongs to.
        written: what gives the function as a program of scalars of a type anew, its arguments, and values of its
            numbers.
    """

    def __init__(
        self,
        address: int | None,
        reads: list[Argument],
        owner: Any,
        numbers: Array | None = None,
        written: Callable[[np.dtype[Any]], ScalarForm] | None = None,
    ) -> None:
        self.owner, self._numbers, self.written = owner, numbers, written
        self._reads, self._address = reads, address
        at = None if numbers is None else numbers.ctypes.data
        self.structure = KernelStructure(address, len(reads), (ctypes.c_int32 * len(Argument))(*reads), at)

    def __call__(self, rows: int, size: int, arguments: Mapping[Argument, Array]) -> Array:
        """The results (rows, size) for rows of arguments, or for one that all rows share."""
        result = np.zeros((rows, size))
        if self._address is None or not rows:
            return result
        numbers = {} if self._numbers is None else {Argument.NUMBERS: self._numbers[None]}
        known = {**arguments, **numbers}
        arrays = [*(np.ascontiguousarray(known[k], float) for k in self._reads), result]
        strides = [a.shape[1] if len(a) == rows > 1 else 0 for a in arrays[:-1]]
        table = (ctypes.c_int64 * (2 * len(arrays)))(*(a.ctypes.data for a in arrays), *strides, size)
        call = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_int64, ctypes.c_int64)(self._address)
        call(ctypes.addressof(table), 0, rows)
        return result

    def check(self) -> None:
        """Raise the error of a function that JAX runs."""
        if isinstance(self.owner, Callback) and self.owner.error is not None:
            error, self.owner.error = self.owner.error, None
            raise error


class _Unbound:
    """A kernel without its numbers.

    Args:
        before: what it reads of numbers, computed of them; None: the numbers themselves.
        place: of the numbers among the arguments of that.
    """

    def __init__(
        self,
        address: int | None,
        reads: list[Argument],
        owner: Any,
        before: ScalarProgram | None = None,
        place: int = 0,
    ) -> None:
        self._made, self._before, self._place = (address, reads, owner), before, place

    @classmethod
    def of_program(cls, program: ScalarProgram, arguments: list[Argument]) -> _Unbound:
        """Machine code for a program of one result.

        Raises:
            NotNative, BuildError: it has no native form.
        """
        if _is_zero(program):
            return cls(None, [], None)
        started, processor = time.perf_counter(), Processor.host()
        form, before, place = native_form(program), None, 0
        with uncollected():
            if Argument.NUMBERS in arguments:
                place = arguments.index(Argument.NUMBERS)
                before, form = computed_before(form, place)
            body = Straight(form, processor.lanes(np.dtype(float)))
            kernel = HostKernel(body, processor, threads=1)
            if not kernel.handle.checked:
                check_kernel(kernel)
        jax.monitoring.record_event_duration_secs(KERNEL_EVENT, time.perf_counter() - started)
        return cls(kernel.symbol[1], [arguments[k] for k in body.read], kernel, before, place)

    @classmethod
    def of_function(
        cls, function: Callable[..., Any], shapes: list[tuple[int, ...]], arguments: list[Argument]
    ) -> _Unbound:
        """A function that JAX runs, called back by the core, for functions without native form."""
        callback = Callback(function, shapes)
        return cls(callback.address, arguments, callback)

    def bound(self, numbers: Array, written: Callable[[np.dtype[Any]], ScalarForm] | None = None) -> BatchKernel:
        if self._before is not None:
            inputs = [np.zeros((1, a.size)) for a in self._before.inputs]
            inputs[self._place] = numbers[None]
            numbers = by_numpy(self._before, inputs)[0][0]
        return BatchKernel(*self._made, np.ascontiguousarray(numbers, float), written)


class Callback:
    """A function of JAX that the core calls.

    Attributes:
        address: of the function in C.
        error: what it raised; no exception passes through C, and the result is NaN there.
    """

    def __init__(self, function: Callable[..., Any], shapes: list[tuple[int, ...]]) -> None:
        self._batched, self._shapes = jax.jit(jax.vmap(function)), shapes
        shaped = [jax.ShapeDtypeStruct(shape, np.dtype(float)) for shape in shapes]
        self._size = math.prod(jax.eval_shape(function, *shaped).shape)
        self.error: BaseException | None = None
        kind = ctypes.CFUNCTYPE(None, ctypes.POINTER(ctypes.c_int64), ctypes.c_int64, ctypes.c_int64)
        self._function = kind(self._run)
        self.address = ctypes.cast(self._function, ctypes.c_void_p).value

    def _run(self, table: Any, first: int, end: int) -> None:
        count = len(self._shapes)
        result = _rows(table[count], table[2 * count + 1], (self._size,), first, end)
        result[:] = np.nan
        try:
            with in_double():
                read = [_rows(table[k], table[count + 1 + k], s, first, end) for k, s in enumerate(self._shapes)]
                result[:] = np.reshape(self._batched(*read), result.shape)
        except BaseException as error:
            self.error = error


class SmoothKernels:
    """A vector function of vectors, with its derivatives with respect to the first of them, as kernels.

    Args:
        function: takes the arguments in their order, then numbers where it has some, and gives a vector; pure.
        arguments: how many entries each has; the first one is what derivatives are by.
        order: of the derivatives that are needed, 0 to 2.
        key: equal for functions that differ in their numbers alone; None: this one is like no other.
        numbers: values of the numbers in its expressions; kernels of the same key differ in these.
    """

    def __init__(
        self,
        function: Callable[..., Any],
        arguments: Mapping[Argument, int],
        order: int = 2,
        key: Hashable = None,
        numbers: Array | None = None,
    ) -> None:
        numbers = np.zeros(0) if numbers is None else numbers
        sizes = dict(arguments) | ({Argument.NUMBERS: len(numbers)} if len(numbers) else {})
        make = functools.partial(_Made, function, sizes, order)
        made = make() if key is None else _CACHE.get((key, tuple(sizes.items()), order), make)
        self.rows = made.rows
        self._made, self._numbers = made, numbers
        self._trace = functools.cache(functools.partial(_traced, function, sizes))

    @functools.cached_property
    def kernels(self) -> list[BatchKernel]:
        """Of the values and of the derivatives; waits for their machine code."""
        return [
            pending.kernel.bound(self._numbers, functools.partial(pending.written, self._trace, self._numbers))
            for pending in self._made.kernels
        ]

    @property
    def structure(self) -> SmoothStructure:
        """For the core."""
        return SmoothStructure(*(kernel.structure for kernel in self.kernels), rows=self.rows)


#: A function as a jaxpr in numbers of a type.
Trace: TypeAlias = Callable[[np.dtype[Any]], ClosedJaxpr]

#: One thread makes machine code, so that it shares Python with the one that traces alone.
_COMPILING = threading.Lock()

#: Functions that were traced, by their keys, those of some twenty problems.
_CACHE = Cache(200)


class _Made:
    """The kernels of a function, without its numbers."""

    def __init__(self, function: Callable[..., Any], arguments: Mapping[Argument, int], order: int) -> None:
        names, sizes = list(arguments), [(size,) for size in arguments.values()]
        with in_double():
            closed = _traced(function, arguments, np.dtype(float))
            (result,) = closed.out_avals
            self.rows = int(result.size)
            plain = lambda *a: jaxpr_as_fun(closed)(*a)[0]  # noqa: E731
            weights = [*names, Argument.WEIGHTS], [*sizes, (self.rows,)]
            makers: list[tuple[Callable[[ClosedJaxpr], ScalarProgram], Callable[..., Any], Any]] = [
                (_value, plain, (names, sizes)),
                (_slopes, jax.jacfwd(plain), (names, sizes)),
                (_bends, functools.partial(_second, plain), weights),
            ]
            self.kernels = [_Pending(closed, *maker) for maker in makers[: order + 1]]


class _Pending:
    """A kernel whose machine code is made in a thread of its own, while others are traced and differentiated."""

    def __init__(self, closed: ClosedJaxpr, made: Callable[..., Any], function: Any, arguments: Any) -> None:
        self._closed, self._maker = closed, made
        self._arguments, self._sizes = arguments
        self._function, self._lock = function, threading.Lock()
        self._kernel: _Unbound | None = None
        self._error: BaseException | None = None
        try:
            self._program: ScalarProgram | None = made(closed)
        except REFUSALS:
            self._program = None
        self._thread = threading.Thread(target=self._compile, daemon=True)
        self._thread.start()

    def _compile(self) -> None:
        if self._program is None:
            return
        try:
            # Settings of JAX are those of a thread.
            with _COMPILING, in_double(), contextlib.suppress(NotNative, BuildError):
                self._kernel = _Unbound.of_program(self._program, self._arguments)
        except BaseException as error:
            self._error = error

    @property
    def kernel(self) -> _Unbound:
        """The kernel, once it is there."""
        with self._lock:
            self._thread.join()
            self._program = None
            if self._error is not None:
                raise self._error
            if self._kernel is None:
                self._kernel = _Unbound.of_function(self._function, self._sizes, self._arguments)
            self._function = None
            return self._kernel

    def written(self, trace: Trace, numbers: Array, dtype: np.dtype[Any]) -> ScalarForm:
        """The function as a program of scalars, made anew.

        Args:
            trace: the function in numbers of a type; series and thresholds are those of the type.
        Raises:
            ModelError: it has no scalar form.
        """
        with jax.enable_x64(dtype == np.float64):
            closed = self._closed if dtype == np.float64 else trace(dtype)
            return ScalarForm(self._maker(closed), self._arguments, numbers)


def _traced(function: Callable[..., Any], sizes: Mapping[Argument, int], dtype: np.dtype[Any]) -> ClosedJaxpr:
    shaped = [jax.ShapeDtypeStruct((size,), dtype) for size in sizes.values()]
    return jax.make_jaxpr(lambda *a: [function(*a)])(*shaped)


def _value(closed: ClosedJaxpr) -> ScalarProgram:
    return XLA().scalars(closed, ANY_SIZE, NATIVE_LIMITS)


def _differentiated(closed: ClosedJaxpr) -> Differentiated:
    # Only the kind that is differentiated has a meaning here.
    places = [("u" if k == 0 else "params", str(k)) for k in range(len(closed.in_avals))]
    return Differentiated(closed, places, Product({}), ("u",))


def _slopes(closed: ClosedJaxpr) -> ScalarProgram:
    return RateJacobian(_differentiated(closed)).program


def _bends(closed: ClosedJaxpr) -> ScalarProgram:
    return WeightedHessian(_differentiated(closed)).program


def _second(function: Callable[..., Any], z: Any, *rest: Any) -> Any:
    *fixed, weights = rest
    return hessian_in_arrays(lambda z: weights @ function(z, *fixed), z)


def _is_zero(program: ScalarProgram) -> bool:
    (nodes,) = program.outputs
    numbers = [program.graph.numbers[int(i)] for i in np.ravel(nodes)]
    return all(value is not None and value == 0 for value in numbers)


def _rows(address: int, stride: int, shape: tuple[int, ...], first: int, end: int) -> Array:
    pointer = ctypes.cast(address + 8 * first * stride, ctypes.POINTER(ctypes.c_double))
    size = math.prod(shape)
    count = max((end - first - 1) * stride + size, 0)
    flat = np.ctypeslib.as_array(pointer, (count,)) if count else np.zeros(0)
    rows = np.lib.stride_tricks.as_strided(flat, (end - first, size), (8 * stride, 8))
    return rows.reshape(-1, *shape) if shape != (size,) else rows
