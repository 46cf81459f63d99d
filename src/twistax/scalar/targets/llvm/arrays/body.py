"""A function of matrices as a kernel: loops for large arrays, scalars for small ones."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray

from .....jax_inside import ClosedJaxpr, Literal, all_equations, inner_jaxprs, jaxpr_as_fun, part, quick_compile
from ....graph import TooLarge
from ....parts.inlining import inlined
from ....parts.part import Constants
from ....primitives.arithmetic import ELEMENTWISE
from ....primitives.interface import InKernels, flat
from ....primitives.table import OPERATIONS, entry_of
from ....reader import scalarize
from ..code import NAMES, Code, Module, NotNative
from ..kernel_body import NATIVE_LIMITS, KernelBody, Rounded, Scalars, native_form
from ..lanes import Array, Rows
from ..machine_code import Processor
from ..straight.pieces import STACK
from .entrywise import Lazy, Value, broadcast, number
from .equations import WRITERS
from .matrices import MatrixWriter
from .memory import View, steps
from .numpy_reference import NoReference, NumpyReference

#: Arrays of at most so many entries are scalars.
_SMALL = 16
#: The most entries of an array: XLA divides larger products among threads.
_LARGEST = 4096
#: The most entries of all arguments and results.
_MOST_ENDS = 2**18
#: The most bytes of all arrays of one member.
_MOST_BYTES = 2**21

_ENTRYWISE = {entry.name for entry in (*OPERATIONS.values(), *ELEMENTWISE)} - {"copy", "optimization_barrier"}
#: Equations whose operands are read by those of their functions alone; branches on small arrays are scalars.
_LOOPS = "scan", "while"
_WITH_FUNCTIONS = (*_LOOPS, "cond")
#: Operations of which a function has some if loops pay off.
_OF_MATRICES = {"dot_general", "cholesky", "lu", "triangular_solve"}


@dataclasses.dataclass(frozen=True, eq=False)
class ArrayForm:
    """A function of arrays in the form from which kernels are written.

    Attributes:
        program: with called functions written out.
        dtype: of its real numbers.
        checked: keep 0 x, 0 / x and x - x.
    """

    program: ClosedJaxpr
    dtype: np.dtype[Any]
    checked: bool

    def counts(self) -> Mapping[str, int]:
        """Equations by name."""
        return Counter(eqn.primitive.name for eqn in all_equations(self.program.jaxpr))


@functools.lru_cache(maxsize=4)  # kernels and calls of one function need it one after the other
def array_form(program: ClosedJaxpr, checked: bool, terminates: bool = False) -> ArrayForm:
    """The form of a function of matrices.

    Args:
        terminates: whether its `while` loops end for all arguments, such as the random ones of a self-test.

    Raises:
        NotNative: it has none, or XLA is as fast.
    """
    program = inlined(program)
    every = list(all_equations(program.jaxpr))
    ends = [v.aval for v in (*program.jaxpr.invars, *program.jaxpr.outvars)]
    avals = [v.aval for eqn in every for v in (*eqn.invars, *eqn.outvars) if eqn.primitive.name not in _WITH_FUNCTIONS]
    if _OF_MATRICES.isdisjoint(eqn.primitive.name for eqn in every):
        raise NotNative("it has no products or factorisations of matrices")
    if not terminates and any(eqn.primitive.name == "while" for eqn in every):
        raise NotNative("it has a loop of unknown length")
    largest = max((aval.size for aval in avals), default=0)
    if largest > _LARGEST or sum(aval.size for aval in ends) > _MOST_ENDS:
        raise NotNative(f"one of the arrays has more than {_LARGEST:,} entries")
    kinds = {np.dtype(aval.dtype) for aval in (*ends, *avals)}
    real = [kind for kind in kinds if kind.kind not in "iub"]
    if len(real) != 1 or not kinds <= NAMES.keys() or program.effects:
        raise NotNative("it has numbers of a type that kernels do not support, or two precisions")
    form = ArrayForm(program, real[0], checked)
    writer = _Writer(Code(Module(Processor.host()), 1), form)
    writer.run(
        program, [View("%a", np.dtype(a.dtype), a.shape, steps(a.shape)) for a in map(_aval, program.jaxpr.invars)]
    )
    if writer.size > _MOST_BYTES:
        raise NotNative("its arrays take too much memory")
    return form


def _aval(v: Any) -> Any:
    return v.aval


class ArrayBody(KernelBody):
    """The kernel body of a function of matrices, from its arguments to its results."""

    def __init__(self, form: ArrayForm, lanes: int) -> None:
        jaxpr = form.program.jaxpr
        arguments, results = (
            [Array(v.aval.shape, np.dtype(v.aval.dtype)) for v in variables]
            for variables in (jaxpr.invars, jaxpr.outvars)
        )
        read = {v for eqn in jaxpr.eqns for v in eqn.invars if not isinstance(v, Literal)} | {
            *_variables(jaxpr.outvars)
        }
        needed = {k for k, v in enumerate(jaxpr.invars) if v in read}
        super().__init__(form, lanes, arguments, results, needed)
        self._by_jax = dict[int, Any]()

    def body(self, code: Code, rows: Mapping[str, Rows]) -> None:
        writer, start = _Writer(code, self.program), len(code.lines)
        inputs = [writer.argument(a, rows.get(f"a{k}")) for k, a in enumerate(self.arguments)]
        outputs = writer.run(self.program.program, inputs)
        for k in self.written:
            writer.result(self.results[k], rows[f"r{k}"], outputs[k])
        lines, code.lines[start:] = code.lines[start:], []
        if writer.size > STACK:
            memory = code.call("ptr", "malloc", ("i64", str(writer.size + 64)))
            place = code.emit(f"ptrtoint ptr {memory} to i64")
            past = code.emit(f"and i64 {code.emit(f'add i64 {place}, 63')}, -64")
            code.lines.append(f"{writer.scratch} = inttoptr i64 {past} to ptr")
            code.lines += lines
            code.call("void", "free", ("ptr", memory))
        else:
            code.lines += [f"{writer.scratch} = alloca [{max(writer.size, 1)} x i8], align 64", *lines]

    @functools.cached_property
    def _by_numpy(self) -> NumpyReference:
        return NumpyReference(self.program.program)

    def exercised(self, arguments: list[NDArray[Any]]) -> list[NDArray[Any]]:
        """Square matrices are positive, so that they have factors."""
        changed = list(arguments)
        for k, array in enumerate(self.arguments):
            if array.dtype.kind == "f" and len(array.shape) > 1 and array.shape[-1] == array.shape[-2]:
                a, n = arguments[k].reshape(-1, *array.shape), array.shape[-1]
                changed[k] = (a @ np.swapaxes(a, -1, -2) / n + np.eye(n, dtype=a.dtype)).reshape(arguments[k].shape)
        return changed

    def plain(self, arguments: Sequence[NDArray[Any]], rounded: Rounded = np.asarray) -> list[NDArray[Any]]:
        """All results by NumPy, or by JAX where NumPy has no such function or would take longer."""
        count = len(arguments[0]) if arguments else 1
        shaped = [rounded(a).reshape(count, *array.shape) for a, array in zip(arguments, self.arguments, strict=True)]
        with contextlib.suppress(NoReference):
            return [r.reshape(count, -1) for r in self._by_numpy.of_rows(shaped, rounded)]
        if count not in self._by_jax:
            run = jax.vmap(jaxpr_as_fun(self.program.program), axis_size=count)
            traced = jax.jit(run, compiler_options=quick_compile(0), keep_unused=True).lower(*shaped)
            self._by_jax[count] = traced.compile()
        return [np.asarray(r).reshape(count, -1) for r in self._by_jax[count](*shaped)]


class CalledLoops(InKernels):
    """A function of matrices that kernels of scalar programs call.

    Args:
        make: makes its kernel, for one member at a time; None where there is none.
    """

    def __init__(self, form: ArrayForm, make: Callable[[], Any]) -> None:
        self._body, self._make = ArrayBody(form, 1), make

    @functools.cached_property
    def kernel(self) -> Any:
        return self._make()

    def plain(self, arguments: Sequence[NDArray[Any]]) -> list[NDArray[Any]]:
        # A kernel has passed its self-test. NumPy takes a tenth of a second for a search, in each call of it.
        body, kernel = self._body, self.__dict__.get("kernel")
        if kernel is None or not body.read:
            return body.plain(arguments)
        results = iter(kernel.run([arguments[k] for k in body.read]))
        empty = np.zeros((len(arguments[0]), 0))
        return [next(results) if k in body.written else empty for k in range(len(body.results))]


class _Writer(MatrixWriter):
    """Writes the equations of a function, arrays in memory and what is small as scalars."""

    def __init__(self, code: Code, form: ArrayForm) -> None:
        super().__init__(code, code.module.processor.lanes(form.dtype) if code.lanes == 1 else 1)
        self.precision, self.checked = form.dtype, form.checked

    def argument(self, array: Array, rows: Rows | None) -> Value:
        """An argument: as it stands in memory, or copied for members side by side."""
        if rows is None:
            return number(0, array.dtype, array.shape)
        if self.code.lanes == 1:
            return View(rows.pointers[0], array.dtype, array.shape, steps(array.shape))
        view = self.buffer(array.dtype, (array.size,))

        def copy(entry: str, _: list[str]) -> list[str]:
            window = rows.window([entry] * self.code.lanes, dataclasses.replace(array, shape=()))
            self.store(view, entry, window.read(0))
            return []

        self.loop("0", str(array.size), copy)
        return view.of(array.shape, steps(array.shape))

    def result(self, array: Array, rows: Rows, value: Value) -> None:
        if self.code.lanes == 1:
            self.assign(View(rows.pointers[0], array.dtype, array.shape, steps(array.shape)), value)
            return
        view = self.contiguous(value)

        def copy(entry: str, _: list[str]) -> list[str]:
            window = rows.window([entry] * self.code.lanes, dataclasses.replace(array, shape=()))
            window.write([self.load(view, entry)])
            return []

        self.loop("0", str(array.size), copy)

    def run(self, program: ClosedJaxpr, inputs: Sequence[Value]) -> list[Value]:
        """The results of a function."""
        return _Equations(self, program, inputs).results()


class _Equations:
    """The equations of one jaxpr in order. Those on small arrays wait until their results are read."""

    def __init__(self, writer: _Writer, program: ClosedJaxpr, inputs: Sequence[Value]) -> None:
        self._writer, self._program, self._jaxpr = writer, program, program.jaxpr
        self._values: dict[Any, Value] = dict(zip(self._jaxpr.invars, inputs, strict=True))
        self._uses = Counter(_variables([v for eqn in self._jaxpr.eqns for v in eqn.invars]))
        self._uses.update(_variables(self._jaxpr.outvars))
        self._waiting: dict[int, Any] = {}
        self._constants = Constants(program)
        made = set(map(id, self._constants.made))
        self._fold([eqn for eqn in self._jaxpr.eqns if id(eqn) not in made])
        for eqn in self._jaxpr.eqns:
            if id(eqn) in made:
                continue
            if _is_small(eqn):
                self._waiting[id(eqn)] = eqn
                continue
            write = WRITERS.get(eqn.primitive.name)
            if eqn.primitive.name in _ENTRYWISE:
                results = [self._entrywise(eqn)]
            elif write is None:
                raise NotNative(f"{eqn.primitive.name} has no native form")
            else:
                results = write(writer, eqn, *map(self.value, eqn.invars))
            for v, result in zip(eqn.outvars, results, strict=True):
                several = self._uses[v] > 1 or (isinstance(result, Lazy) and result.operations > 50)
                self._values[v] = (
                    writer.stored(result) if several and isinstance(result, Lazy) and result.operands else result
                )

    def results(self) -> list[Value]:
        return [self.value(v) for v in self._jaxpr.outvars]

    def value(self, v: Any) -> Value:
        """The value of an operand."""
        if isinstance(v, Literal):
            return number(v.val, np.dtype(_aval(v).dtype), np.shape(v.val))
        if v not in self._values:
            self._write_waiting()
        return self._values[v]

    def _fold(self, eqns: Sequence[Any]) -> None:
        """What depends on constants alone."""
        read = _variables([v for eqn in eqns for v in eqn.invars] + self._jaxpr.outvars)
        wanted = [v for v in dict.fromkeys(read) if v in self._constants.known]
        if wanted:
            program = scalarize(self._constants.close([], wanted))
            for v, entries in zip(wanted, program.outputs, strict=True):
                array = program.graph.values(entries)
                if array is None:
                    raise NotNative("it has constants that are not computed")
                is_constant = array.size > 0 and bool((array == array.flat[0]).all())
                self._values[v] = (
                    number(array.flat[0], array.dtype, array.shape) if is_constant else self._writer.table(array)
                )
        for v, array in zip(self._jaxpr.constvars, self._program.consts, strict=True):
            self._values.setdefault(v, self._writer.table(np.asarray(array)))

    def _entrywise(self, eqn: Any) -> Value:
        entry, aval = entry_of(eqn), eqn.outvars[0].aval
        operands = tuple(
            broadcast(x, aval.shape, range(len(x.shape))) if x.shape else broadcast(x, aval.shape, ())
            for x in map(self.value, eqn.invars)
        )

        def make(reader: Any, *nodes: Any) -> Any:
            scalars = entry.scalars(reader, eqn, *nodes) if entry is not None else None
            if scalars is None:
                raise NotNative(f"{eqn.primitive.name} has no native form")
            return scalars[0]

        return Lazy(make, operands, aval.shape, np.dtype(aval.dtype))

    def _write_waiting(self) -> None:
        """The waiting equations as scalars, with the results that others read in memory."""
        eqns, writer = list(self._waiting.values()), self._writer
        self._waiting.clear()
        made = dict.fromkeys(v for eqn in eqns for v in eqn.outvars)
        inside = Counter(_variables([v for eqn in eqns for v in eqn.invars]))
        outputs = [v for v in made if self._uses[v] > inside[v]]
        read = dict.fromkeys(v for v in _variables([v for eqn in eqns for v in eqn.invars]) if v not in made)
        views = [writer.stored(self.value(v)) for v in read]
        try:
            program = native_form(
                scalarize(part(self._jaxpr, eqns, list(read), outputs), checked=writer.checked, limits=NATIVE_LIMITS)
            )
        except TooLarge as error:
            raise NotNative(str(error).splitlines()[0]) from error

        def entry(argument: int, place: int) -> str:
            view = views[argument]
            places = np.unravel_index(place, view.shape) if view.shape else ()
            return writer.load(view, str(sum(int(p) * s for p, s in zip(places, view.strides, strict=True))))

        scalars = Scalars(writer.code.of(writer.code.lanes), program, entry)
        for v, array in zip(outputs, program.outputs, strict=True):
            self._values[v] = view = writer.buffer(np.dtype(v.aval.dtype), v.aval.shape)
            for place, value in enumerate(scalars.compute(flat(array))):
                writer.store(view, str(place), value)


def _variables(variables: Sequence[Any]) -> list[Any]:
    return [v for v in variables if not isinstance(v, Literal)]


def _is_small(eqn: Any) -> bool:
    entry = entry_of(eqn)
    if entry is None or (entry.read is None and not hasattr(entry, "number")):
        return False
    inside = (one for body in inner_jaxprs(eqn) for one in all_equations(body.jaxpr))
    if any(one.primitive.name in _LOOPS for one in (eqn, *inside)):
        return False
    return all(v.aval.size <= _SMALL for v in (*eqn.invars, *eqn.outvars))
