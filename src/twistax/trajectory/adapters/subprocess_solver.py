"""CasADi's solvers in a separate process, which can be terminated when a time limit is reached.

A solver in an infinite loop calls no callback and holds Python's global lock: nothing within its process can stop it,
not even a signal. The subprocess requests values and derivatives from this process.
"""

from __future__ import annotations

import contextlib
import pickle
import subprocess
import sys
import time
import weakref
from collections.abc import Callable, Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np

from . import casadi_program
from .casadi_program import SolverRefused, SolverResult
from .program import NonlinearProgram, ProgramStart

#: The exit status of a solver that the clock has ended.
OUT_OF_TIME = "Out of time"


class SubprocessSolver:
    """A `CasadiProgram` in a subprocess. It starts with the first solve, and again after a solve that terminated it."""

    def __init__(self, program: NonlinearProgram, plugin: str, options: Mapping[str, Any]) -> None:
        self.program = program
        patterns = {
            name: SimpleNamespace(rows=entries.rows, columns=entries.columns)
            for name, entries in (("jacobian", program.jacobian), ("hessian", program.hessian))
        }
        facts = {name: getattr(program, name) for name in ("size", "count", "lower_rows")} | patterns
        self._plugin, self._facts = plugin, (facts, plugin, dict(options))
        self._process: subprocess.Popen[bytes] | None = None

    def _say(self, words: Any) -> None:
        pickle.dump(words, self._process.stdin, protocol=5)  # type: ignore[union-attr, arg-type]
        self._process.stdin.flush()  # type: ignore[union-attr]

    def solve(
        self,
        start: ProgramStart,
        options: Mapping[str, Any],
        progress: Callable[..., None] | None,
        seconds: float,
    ) -> SolverResult:
        """As `CasadiProgram.solve`, with a time limit in seconds, after which the result is the last iterate."""
        due, steps, x = time.monotonic() + seconds, 0, start.x
        try:
            if self._process is None:
                command = [sys.executable, "-P", casadi_program.__file__]
                pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
                self._process = subprocess.Popen(command, start_new_session=True, **pipes)
                self._end = weakref.finalize(self, _ended, self._process)
                self._say(self._facts)
            self._say((seconds, start._asdict(), dict(options)))
            while True:
                what, *arguments = pickle.load(self._process.stdout)  # type: ignore[arg-type]
                if what == "done":
                    return SolverResult(*arguments[0])
                if what == "refused":
                    raise SolverRefused(arguments[0])
                if what == "first_derivatives":
                    x = arguments[0]
                    if progress is not None:
                        progress(*self.program.values(x))
                steps += what == "lagrangian_hessian"
                self._say(getattr(self.program, what)(*arguments))
        except (EOFError, BrokenPipeError):
            self._forget()
            if time.monotonic() < due:
                raise SolverRefused(
                    f"the process of {self._plugin} (CasADi) ended before the solve was complete"
                ) from None
            zeros = np.zeros(self.program.size), np.zeros(self.program.count)
            return SolverResult(x, *zeros, steps, False, OUT_OF_TIME)
        except BaseException:  # the subprocess would wait for an answer
            self._forget()
            raise

    def _forget(self) -> None:
        self._process = None
        self._end()


def _ended(process: subprocess.Popen[bytes]) -> None:
    process.kill()
    process.wait()
    for pipe in (process.stdin, process.stdout):
        with contextlib.suppress(BrokenPipeError):  # pending answers that no process reads
            pipe.close()  # type: ignore[union-attr]
