"""Which batches of a kernel use other threads, by a clock that the test sets and a pool whose threads come too late."""

import ctypes
from typing import Any

import numpy as np
import pytest

pytest.importorskip("llvmlite", reason="native kernels need llvmlite")

import llvmlite.binding as llvm
from native_programs import program_of

from twistax.scalar.primitives.table import OPERATIONS
from twistax.scalar.targets.llvm.code import Module
from twistax.scalar.targets.llvm.handler import write_host_handler
from twistax.scalar.targets.llvm.kernel_body import native_form
from twistax.scalar.targets.llvm.machine_code import Processor
from twistax.scalar.targets.llvm.straight.body import Straight

POINTERS = ctypes.POINTER(ctypes.c_void_p)
CLOCK = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_int32, ctypes.POINTER(ctypes.c_int64))
CALL = ctypes.CFUNCTYPE(ctypes.c_void_p, POINTERS)
TASK = ctypes.CFUNCTYPE(None, ctypes.c_void_p)


class Batches:
    """Batches of one kernel with two threads."""

    def __init__(self) -> None:
        processor = Processor.host()
        body = Straight(native_form(program_of([OPERATIONS["neg"]], np.float64, 1)), 1)
        body.chunk = 2
        module = Module(processor)
        body.write(module)
        write_host_handler(module, body, 2)
        text = (
            module.text()
            .replace("@clock_gettime(", "@set_clock(")
            .replace("define internal ptr @start", "define ptr @start")
        )
        self._times: list[int] = []
        self._tasks: list[tuple[Any, Any]] = []
        self._callbacks = CLOCK(self._now), CALL(self._count), CALL(self._schedule)
        addresses = [ctypes.cast(f, ctypes.c_void_p).value for f in self._callbacks]
        llvm.initialize_native_target()
        llvm.initialize_native_asmprinter()
        llvm.add_symbol("set_clock", addresses[0])
        machine = llvm.Target.from_default_triple().create_target_machine(jit=True)
        self._engine = llvm.create_mcjit_compiler(llvm.parse_assembly(text), machine)
        self._engine.finalize_object()
        start = self._engine.get_function_address("start")
        self._start = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int64)(start)
        self._api = (ctypes.c_void_p * 19)()
        self._api[17], self._api[18] = addresses[2], addresses[1]
        self._frame = (ctypes.c_void_p * 4)(None, None, ctypes.addressof(self._api), None)

    def _now(self, _: int, time: Any) -> int:
        time[0], time[1] = divmod(self._times.pop(0), 1_000_000_000)
        return 0

    def _count(self, arguments: Any) -> None:
        ctypes.cast(arguments[3], ctypes.POINTER(ctypes.c_int64))[0] = 2

    def _schedule(self, arguments: Any) -> None:
        self._tasks.append((TASK(arguments[3]), arguments[4]))

    def share(self, rows: int, alone: int, shared: int) -> bool:
        """Whether a batch was shared that takes so many ns alone and in threads."""
        x, y = np.arange(float(rows)), np.zeros(rows)
        table = (ctypes.c_int64 * 4)(x.ctypes.data, y.ctypes.data, 1, 1)
        # With threads the clock is read again where the rows of the first one are done.
        self._times[:] = [0, alone, shared]
        assert self._start(ctypes.addressof(self._frame), ctypes.addressof(table), rows) is None
        np.testing.assert_array_equal(y, -x)
        tasks = list(self._tasks)
        self._tasks.clear()
        for task, job in tasks:
            task(job)
        assert len(self._times) == (0 if tasks else 1)
        return bool(tasks)


def test_a_loss_is_paid_by_batches_on_one_thread() -> None:
    """A batch that lost 1,000 ns is paid by sixteen batches of 1,000 ns, and one more for the rounding."""
    batches = Batches()
    assert batches.share(64, 1_000, 900)
    assert batches.share(64, 1_000, 2_000)
    assert [batches.share(64, 1_000, 900) for _ in range(18)] == [*17 * [False], True]


def test_larger_batches_keep_their_threads() -> None:
    """Small batches that lose do not take the threads of large ones, which gain."""
    batches = Batches()
    assert batches.share(16, 1_000, 9_000)
    assert batches.share(1_024, 64_000, 33_000)
    assert not batches.share(16, 1_000, 9_000)


def test_a_stopped_process_is_no_loss_of_threads() -> None:
    """After a minute without the processor threads are used again within seconds of computing."""
    batches = Batches()
    assert batches.share(64, 1_000, 60_000_000_000)
    assert not batches.share(64, 1_700_000_000, 0)
    assert batches.share(64, 1_000, 900)
