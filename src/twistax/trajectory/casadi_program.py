"""A `Program` as CasADi sees it: functions that call back, with sparse first and second derivatives of their own.

CasADi derives what its solvers need from reverse derivatives, so the program is four functions: f and g; their
Jacobian; the gradient of weight f + multipliers . g; and its Jacobian, the Hessian.

Run as a script this file is the other side of `apart.py`, a process with CasADi and NumPy alone; so it imports no more.
"""

from __future__ import annotations

import faulthandler
import os
import pickle
import sys
from collections.abc import Callable, Mapping, Sequence
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple

import casadi
import numpy as np
from numpy import ndarray as Array

if TYPE_CHECKING:
    from .program import Entries, Program, Start


class Refused(RuntimeError):
    """A solver that does not run as it was asked to."""


class Attempt(NamedTuple):
    """What a solver of CasADi's came back with."""

    x: Array
    of_bounds: Array  # multipliers
    of_rows: Array
    iterations: int
    success: bool
    word: str  # the solver's for how it ended


class CasadiProgram:
    """A program that CasADi's solvers solve; made once, for any start."""

    def __init__(self, program: Program, plugin: str, options: Mapping[str, Any]) -> None:
        self.program = program
        self._plugin = plugin
        self._memory: dict[str, tuple[bytes, Any]] = {}
        self._values = _Values(self)
        x = casadi.MX.sym("x", program.size)
        f, g = self._values(x)
        self._nlp = {"x": x, "f": f, "g": g}
        #: The entries of g' in the order of its transpose, column by column.
        self.transposed = np.lexsort((program.jacobian.columns, program.jacobian.rows))
        self._solvers: dict[tuple[Any, ...], Any] = {}
        self._options = options

    def solve(
        self,
        start: Start,
        own: Mapping[str, Any],
        seen: Callable[..., None] | None = None,
        seconds: float = np.inf,
    ) -> Attempt:
        """Solve from a start; `own` are options of the plugin on top of those it was made with. There is no clock
        here."""
        self._seen, self._memory = seen, {}
        key, program = tuple(sorted(own.items())), self.program
        whole = dict(self._options)
        whole[self._plugin] = {**whole.get(self._plugin, {}), **own}
        arguments = {"x0": start.x, "lbx": start.lower, "ubx": start.upper}
        arguments |= {"lam_x0": start.of_bounds, "lam_g0": start.of_rows}
        self._raised: Exception | None = None
        try:
            if key not in self._solvers:
                self._solvers[key] = casadi.nlpsol("solver", self._plugin, self._nlp, whole)
            solver = self._solvers[key]
            found = solver(lbg=program.lower_rows, ubg=np.zeros(program.count), **arguments)
        except RuntimeError as error:
            if self._raised is None:
                raise Refused(
                    f"{self._plugin} of CasADi does not run, with the options {whole[self._plugin]}: "
                    f"{str(error).strip().splitlines()[-1]}"
                ) from None
        if self._raised is not None:
            raise self._raised
        stats = solver.stats()
        return Attempt(
            np.asarray(found["x"]).ravel(),
            np.asarray(found["lam_x"]).ravel(),
            np.asarray(found["lam_g"]).ravel(),
            int(stats.get("iter_count", 0)),
            bool(stats["success"]),
            str(stats["return_status"]),
        )

    # ---- evaluations, the last of each kept -----------------------------------------------------------------------

    def _kept(self, what: str, key: bytes, make: Callable[[], Any]) -> Any:
        known = self._memory.get(what)
        if known is None or known[0] != key:
            known = self._memory[what] = key, make()
        return known[1]

    def values(self, x: Array) -> tuple[float, Array]:
        return self._kept("values", x.tobytes(), lambda: self.program.values(x))

    def slopes(self, x: Array) -> tuple[Array, Array]:
        def make() -> tuple[Array, Array]:
            if self._seen is not None:
                try:
                    self._seen(*self.values(x))
                except Exception as error:  # the solver would take it for numbers that are not finite
                    self._raised = error
                    raise
            return self.program.slopes(x)

        return self._kept("slopes", x.tobytes(), make)

    def pull(self, x: Array, weight: float, multipliers: Array) -> Array:
        """The gradient of weight f + multipliers . g."""
        gradient, numbers = self.slopes(x)
        entries = self.program.jacobian
        found = np.bincount(entries.columns, numbers * multipliers[entries.rows], minlength=self.program.size)
        return weight * gradient + found

    def bend(self, x: Array, weight: float, multipliers: Array) -> Array:
        key = x.tobytes() + multipliers.tobytes() + np.float64(weight).tobytes()
        return self._kept("bend", key, lambda: self.program.bend(x, weight, multipliers))


def sparsity(rows: int, columns: int, entries: Entries) -> Any:
    """CasADi's pattern of entries that are sorted by columns."""
    starts = np.searchsorted(entries.columns, np.arange(columns + 1))
    return casadi.Sparsity(rows, columns, starts.tolist(), entries.rows.tolist())


class _Callback(casadi.Callback):
    """A function that calls back, by the patterns of what goes in and what comes out."""

    def __init__(self, program: CasadiProgram, inputs: list[Any], outputs: list[Any], names: Any = None) -> None:
        casadi.Callback.__init__(self)
        self._program, self._inputs, self._outputs, self._names = program, inputs, outputs, names
        self._derived: list[Any] = []  # CasADi does not keep them alive
        self.construct(names[0] if names else "values", {})

    def get_n_in(self) -> int:
        return len(self._inputs)

    def get_n_out(self) -> int:
        return len(self._outputs)

    def get_sparsity_in(self, i: int) -> Any:
        return self._inputs[i]

    def get_sparsity_out(self, i: int) -> Any:
        return self._outputs[i]

    def has_eval_buffer(self) -> bool:
        return True

    def eval_buffer(self, given: Sequence[Any], results: Sequence[Any]) -> int:
        for result, numbers in zip(results, self.run(*(_read(a).copy() for a in given)), strict=True):
            if result is not None:
                _read(result)[:] = numbers
        return 0

    #: The numbers of the results, of those of the arguments.
    run: Callable[..., list[Any]]

    def get_name_in(self, i: int) -> str:
        return self._names[1][i] if self._names else f"i{i}"

    def get_name_out(self, i: int) -> str:
        return self._names[2][i] if self._names else f"o{i}"

    def _keep(self, derived: Any) -> Any:
        self._derived.append(derived)
        return derived


def _vector(size: int, dense: bool = True) -> Any:
    return casadi.Sparsity.dense(size, 1) if dense else casadi.Sparsity(size, 1)


def _read(memory: Any) -> Array:
    """Numbers in memory of CasADi's."""
    return np.frombuffer(memory, float) if memory is not None and len(memory) else np.zeros(0)


class _Values(_Callback):
    """x -> f, g."""

    def __init__(self, program: CasadiProgram) -> None:
        own = program.program
        super().__init__(program, [_vector(own.size)], [_vector(1), _vector(own.count)])

    def run(self, x: Array) -> list[Any]:
        return list(self._program.values(x))

    def has_jacobian(self) -> bool:
        return True

    def has_jac_sparsity(self, output: int, given: int) -> bool:
        return True

    def get_jac_sparsity(self, output: int, given: int, symmetric: bool) -> Any:
        own = self._program.program
        return sparsity(own.count, own.size, own.jacobian) if output else casadi.Sparsity.dense(1, own.size)

    def get_jacobian(self, name: str, inputs: Sequence[str], outputs: Sequence[str], options: Any) -> Any:
        own = self._program.program
        given = [_vector(own.size), _vector(1, False), _vector(own.count, False)]
        patterns = [self.get_jac_sparsity(i, 0, False) for i in range(2)]
        return self._keep(_Jacobian(self._program, given, patterns, (name, inputs, outputs)))

    def has_reverse(self, count: int) -> bool:
        return count == 1

    def get_reverse(self, count: int, name: str, inputs: Sequence[str], outputs: Sequence[str], options: Any) -> Any:
        own = self._program.program
        given = [_vector(own.size), _vector(1, False), _vector(own.count, False), _vector(1), _vector(own.count)]
        return self._keep(_Gradient(self._program, given, [_vector(own.size)], (name, inputs, outputs)))


class _Jacobian(_Callback):
    """x, (f, g) -> f', g'."""

    def run(self, x: Array, *_: Array) -> list[Any]:
        return list(self._program.slopes(x))


class _Gradient(_Callback):
    """x, (f, g), weight, multipliers -> gradient of weight f + multipliers . g."""

    def run(self, x: Array, f: Array, g: Array, weight: Array, multipliers: Array) -> list[Any]:
        return [self._program.pull(x, float(weight[0]), multipliers)]

    def has_jacobian(self) -> bool:
        return True

    def has_jac_sparsity(self, output: int, given: int) -> bool:
        return True

    def get_jac_sparsity(self, output: int, given: int, symmetric: bool) -> Any:
        own = self._program.program
        sides = [
            sparsity(own.size, own.size, own.hessian),
            casadi.Sparsity(own.size, 1),
            casadi.Sparsity(own.size, own.count),
            casadi.Sparsity.dense(own.size, 1),
            sparsity(own.count, own.size, own.jacobian).T,
        ]
        return sides[given]

    def get_jacobian(self, name: str, inputs: Sequence[str], outputs: Sequence[str], options: Any) -> Any:
        patterns = [self.get_jac_sparsity(0, i, False) for i in range(5)]
        given = [*self._inputs, _vector(self._program.program.size, False)]
        return self._keep(_Hessian(self._program, given, patterns, (name, inputs, outputs)))


class _Hessian(_Callback):
    """x, (f, g), weight, multipliers, (gradient) -> its Jacobian by each."""

    def run(self, x: Array, f: Array, g: Array, weight: Array, multipliers: Array, _: Array) -> list[Any]:
        gradient, numbers = self._program.slopes(x)
        bend = self._program.bend(x, float(weight[0]), multipliers)
        return [bend, np.zeros(0), np.zeros(0), gradient, numbers[self._program.transposed]]


def _answer(inbox: BinaryIO, outbox: BinaryIO) -> None:
    """Solve what comes in, until nothing does; values and derivatives are asked for.

    The clock that ends a solve is a thread without Python's lock, which whoever hangs in a library holds.
    """

    def say(*words: Any) -> None:
        pickle.dump(words, outbox, protocol=5)
        outbox.flush()

    def asked(what: str) -> Callable[..., Any]:
        def ask(x: Array, *more: Any) -> Any:
            try:
                say(what, x, *more)
                return pickle.load(inbox)
            except (EOFError, OSError):  # nobody is there; CasADi would print all its numbers
                os._exit(1)

        return ask

    facts, plugin, options = pickle.load(inbox)
    program: Any = SimpleNamespace(**facts, **{what: asked(what) for what in ("values", "slopes", "bend")})
    made, nowhere = CasadiProgram(program, plugin, options), open(os.devnull, "w")  # noqa: SIM115
    while True:
        try:
            seconds, fields, own = pickle.load(inbox)
            start: Any = SimpleNamespace(**fields)
        except EOFError:
            return
        faulthandler.dump_traceback_later(min(seconds, 1e6), exit=True, file=nowhere)
        try:
            say("done", tuple(made.solve(start, own)))
        except Refused as error:
            say("refused", str(error))
        faulthandler.cancel_dump_traceback_later()


if __name__ == "__main__":
    spoken = os.dup(1)
    os.dup2(2, 1)  # what solvers print is not taken for an answer
    with os.fdopen(spoken, "wb") as outbox:
        _answer(sys.stdin.buffer, outbox)
