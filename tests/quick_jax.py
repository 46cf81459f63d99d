"""Settings of JAX and Python for processes that trace and compile much and run little: tests, and programs of the docs.

They change no result. Tests import this file; `docs/site/execution.py` runs it first where TWISTAX_BEGIN names it.
"""

import gc
import threading
from collections.abc import Callable

import jax
from jax._src.interpreters import mlir

# Where each operation was written would be put into each program: a twentieth of the time, and no test reads it.
jax.config.update("jax_traceback_in_locations_limit", 0)

if jax.__version_info__ < (0, 11):
    # As newer versions of JAX do: a context of MLIR for each program took a quarter of the time of compiling a small
    # one and three quarters of its memory, so that much was dropped and compiled again.
    _contexts = threading.local()

    def _shared_context(make: Callable[[], object] = mlir.make_ir_context) -> object:
        """A context of this thread, which fifty programs share; a new one within the lowering of another program."""
        if mlir.ir.Context.current is not None:
            return make()
        if getattr(_contexts, "left", 0) == 0:
            _contexts.context, _contexts.left = make(), 50
        _contexts.left -= 1
        return _contexts.context

    mlir.make_ir_context = _shared_context

# Traced programs are millions of objects: looking through them for cycles took an eighth of the suite's time.
gc.set_threshold(50_000, 20, 20)
