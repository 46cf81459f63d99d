"""A `NonlinearProgram` as a CasADi problem: callback functions with sparse derivatives.

CasADi derives the functions that its solvers need from reverse derivatives. So the program is four functions: f and g;
their Jacobian; the gradient of weight f + multipliers . g; and its Jacobian, the Hessian.

Run as a script, this file is the subprocess of `subprocess_solver.py`, which needs only CasADi and NumPy. So it imports
nothing else.
"""

from __future__ import annotations

import faulthandler
import os
import pickle
import sys
from collections.abc import Callable, Mapping, Sequence
from types import SimpleNamespace
from typing import Any, BinaryIO, NamedTuple

import casadi
import numpy as np
from numpy import ndarray as Array


class SolverRefused(RuntimeError):
    """The error of a solver that does not accept its options."""


class SolverResult(NamedTuple):
    """The result of a CasADi solver."""

    x: Array
    of_bounds: Array  # multipliers
    of_rows: Array
    iterations: int
    success: bool
    word: str  # the solver's name for its exit status


class CasadiProgram:
    """A program for CasADi's solvers; it is built once and solved from any start."""

    def __init__(self, program: Any, plugin: str, options: Mapping[str, Any]) -> None:
        self.program, self._plugin, self._options = program, plugin, options
        self._memory: dict[str, tuple[bytes, Any]] = {}
        self._values = self._as_function()
        x = casadi.MX.sym("x", program.size)
        f, g = self._values(x)
        self._nlp = {"x": x, "f": f, "g": g}
        self._solvers: dict[tuple[Any, ...], Any] = {}

    def solve(
        self,
        start: Any,
        options: Mapping[str, Any],
        progress: Callable[..., None] | None = None,
        seconds: float = np.inf,
    ) -> SolverResult:
        """Solve from a start, with options of the plugin in addition to those of the constructor. There is no time
        limit.
        """
        self._progress, self._memory = progress, {}
        key, program = tuple(sorted(options.items())), self.program
        every = {**self._options, self._plugin: {**self._options.get(self._plugin, {}), **options}}
        arguments = {"x0": start.x, "lbx": start.lower, "ubx": start.upper}
        arguments |= {"lam_x0": start.of_bounds, "lam_g0": start.of_rows}
        self._raised: Exception | None = None
        try:
            if key not in self._solvers:
                self._solvers[key] = casadi.nlpsol("solver", self._plugin, self._nlp, every)
            solver = self._solvers[key]
            result = solver(lbg=program.lower_rows, ubg=np.zeros(program.count), **arguments)
        except RuntimeError as error:
            if self._raised is None:
                raise SolverRefused(
                    f"{self._plugin} of CasADi does not run, with the options {every[self._plugin]}: "
                    f"{str(error).strip().splitlines()[-1]}"
                ) from None
        if self._raised is not None:
            raise self._raised
        stats = solver.stats()
        return SolverResult(
            np.asarray(result["x"]).ravel(),
            np.asarray(result["lam_x"]).ravel(),
            np.asarray(result["lam_g"]).ravel(),
            int(stats.get("iter_count", 0)),
            bool(stats["success"]),
            str(stats["return_status"]),
        )

    # ---- evaluations, of which the last one is cached -------------------------------------------------------------

    def _kept(self, what: str, key: bytes, make: Callable[[], Any]) -> Any:
        known = self._memory.get(what)
        if known is None or known[0] != key:
            known = self._memory[what] = key, make()
        return known[1]

    def _f_and_g(self, x: Array) -> tuple[float, Array]:
        values: tuple[float, Array] = self._kept("values", x.tobytes(), lambda: self.program.values(x))
        return values

    def _slopes(self, x: Array) -> tuple[Array, Array]:
        def make() -> Any:
            if self._progress is not None:
                try:
                    self._progress(*self._f_and_g(x))
                except Exception as error:  # the solver would treat the error as non-finite numbers
                    self._raised = error
                    raise
            return self.program.first_derivatives(x)

        slopes: tuple[Array, Array] = self._kept("slopes", x.tobytes(), make)
        return slopes

    def _gradient(self, x: Array, weight: float, multipliers: Array) -> Array:
        """The gradient of weight f + multipliers . g."""
        gradient, numbers = self._slopes(x)
        entries = self.program.jacobian
        of_rows = np.bincount(entries.columns, numbers * multipliers[entries.rows], minlength=self.program.size)
        return weight * gradient + of_rows

    def _hessian(self, x: Array, weight: float, multipliers: Array) -> Array:
        key = x.tobytes() + multipliers.tobytes() + np.float64(weight).tobytes()
        make = lambda: self.program.lagrangian_hessian(x, weight, multipliers)  # noqa: E731
        numbers: Array = self._kept("hessian", key, make)
        return numbers

    # ---- CasADi functions -----------------------------------------------------------------------------------------

    def _as_function(self) -> _Function:
        """The CasADi function x -> f, g, with its derivatives."""
        n, m = self.program.size, self.program.count
        jacobian, hessian = self.program.jacobian, self.program.hessian
        x, f, g = (casadi.Sparsity.dense(size, 1) for size in (n, 1, m))
        #: The entries of g' in the order of its transpose, column by column.
        transposed = np.lexsort((jacobian.columns, jacobian.rows))

        def of_gradient(x: Array, f: Array, g: Array, weight: Array, multipliers: Array, _: Array) -> list[Array]:
            gradient, numbers = self._slopes(x)
            none = np.zeros(0)
            return [self._hessian(x, float(weight[0]), multipliers), none, none, gradient, numbers[transposed]]

        pattern = sparsity(m, n, jacobian)
        of_pull = sparsity(n, n, hessian), casadi.Sparsity(n, 1), casadi.Sparsity(n, m), x, pattern.T
        none = [casadi.Sparsity(1, 1), casadi.Sparsity(m, 1)]

        def gradient(names: Any) -> _Function:
            run = lambda x, f, g, weight, multipliers: [self._gradient(x, float(weight[0]), multipliers)]  # noqa: E731
            return _Function(run, [x, *none, f, g], [x], names, jacobian=([of_pull], of_gradient))

        slopes = ([[casadi.Sparsity.dense(1, n)], [pattern]], lambda x, *_: list(self._slopes(x)))
        return _Function(lambda x: list(self._f_and_g(x)), [x], [f, g], jacobian=slopes, reverse=gradient)


def sparsity(rows: int, columns: int, entries: Any) -> Any:
    """CasADi's sparsity pattern of entries that are sorted by columns."""
    starts = np.searchsorted(entries.columns, np.arange(columns + 1))
    return casadi.Sparsity(rows, columns, starts.tolist(), entries.rows.tolist())


class _Function(casadi.Callback):
    """A CasADi function that calls back to Python.

    Args:
        run: computes the entries of the results from those of the arguments.
        inputs, outputs: sparsity patterns.
        names: the names of the function, of its arguments and of its results.
        jacobian: sparsity patterns by result and argument, and a function that computes their entries from arguments
            and results.
        reverse: names -> the function of reverse derivatives.
    """

    def __init__(
        self,
        run: Callable[..., list[Any]],
        inputs: list[Any],
        outputs: list[Any],
        names: Any = ("values", None, None),
        *,
        jacobian: tuple[Sequence[Sequence[Any]], Callable[..., list[Any]]] | None = None,
        reverse: Callable[[Any], _Function] | None = None,
    ) -> None:
        casadi.Callback.__init__(self)
        self._run, self._inputs, self._outputs, self._names = run, inputs, outputs, names
        self._jacobian, self._reverse = jacobian, reverse
        self._derived: list[_Function] = []  # CasADi does not keep references to them
        self.construct(names[0], {})

    def get_n_in(self) -> int:
        return len(self._inputs)

    def get_n_out(self) -> int:
        return len(self._outputs)

    def get_sparsity_in(self, i: int) -> Any:
        return self._inputs[i]

    def get_sparsity_out(self, i: int) -> Any:
        return self._outputs[i]

    def get_name_in(self, i: int) -> str:
        return self._names[1][i] if self._names[1] else f"i{i}"

    def get_name_out(self, i: int) -> str:
        return self._names[2][i] if self._names[2] else f"o{i}"

    def has_eval_buffer(self) -> bool:
        return True

    def eval_buffer(self, arguments: Sequence[Any], results: Sequence[Any]) -> int:
        for result, numbers in zip(results, self._run(*(_read(a).copy() for a in arguments)), strict=True):
            if result is not None:
                _read(result)[:] = numbers
        return 0

    def has_jacobian(self) -> bool:
        return self._jacobian is not None

    def has_jac_sparsity(self, output: int, argument: int) -> bool:
        return self._jacobian is not None

    def get_jac_sparsity(self, output: int, argument: int, symmetric: bool) -> Any:
        return self._jacobian[0][output][argument] if self._jacobian else None

    def get_jacobian(self, name: str, inputs: Sequence[str], outputs: Sequence[str], options: Any) -> Any:
        assert self._jacobian is not None
        patterns, run = self._jacobian
        arguments = [*self._inputs, *(casadi.Sparsity(a.size1(), 1) for a in self._outputs)]
        self._derived.append(_Function(run, arguments, [p for row in patterns for p in row], (name, inputs, outputs)))
        return self._derived[-1]

    def has_reverse(self, count: int) -> bool:
        return self._reverse is not None and count == 1

    def get_reverse(self, count: int, name: str, inputs: Sequence[str], outputs: Sequence[str], options: Any) -> Any:
        assert self._reverse is not None
        self._derived.append(self._reverse((name, inputs, outputs)))
        return self._derived[-1]


def _read(memory: Any) -> Array:
    return np.frombuffer(memory, float) if memory is not None and len(memory) else np.zeros(0)


def _answer(inbox: BinaryIO, outbox: BinaryIO) -> None:
    """The loop of the subprocess: solve each start that it receives; values and derivatives come from the parent
    process.

    The clock that ends a solve is a thread that does not need Python's global lock, which a solver in an infinite loop
    holds.
    """

    def say(*words: Any) -> None:
        pickle.dump(words, outbox, protocol=5)
        outbox.flush()

    def remote(what: str) -> Callable[..., Any]:
        def ask(x: Array, *more: Any) -> Any:
            try:
                say(what, x, *more)
                return pickle.load(inbox)
            except (EOFError, OSError):  # the parent process has ended; CasADi would print all its numbers
                os._exit(1)

        return ask

    facts, plugin, options = pickle.load(inbox)
    functions = {what: remote(what) for what in ("values", "first_derivatives", "lagrangian_hessian")}
    made, nowhere = CasadiProgram(SimpleNamespace(**facts, **functions), plugin, options), open(os.devnull, "w")  # noqa: SIM115
    while True:
        try:
            seconds, fields, options = pickle.load(inbox)
        except EOFError:
            return
        faulthandler.dump_traceback_later(min(seconds, 1e6), exit=True, file=nowhere)
        try:
            say("done", tuple(made.solve(SimpleNamespace(**fields), options)))
        except SolverRefused as error:
            say("refused", str(error))
        faulthandler.cancel_dump_traceback_later()


if __name__ == "__main__":
    spoken = os.dup(1)
    os.dup2(2, 1)  # output that solvers print must not be mistaken for an answer
    with os.fdopen(spoken, "wb") as outbox:
        _answer(sys.stdin.buffer, outbox)
