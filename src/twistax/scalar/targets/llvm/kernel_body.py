"""A scalar program as one function that computes as many batch members at once as a vector has lanes."""

from __future__ import annotations

import dataclasses
import functools
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...graph import Limits, OpaqueCall, TooLarge
from ...primitives.entry import Operation
from ...primitives.interface import RepeatedMembers, flat, is_loop, kernel_of
from ...primitives.table import OPERATIONS
from ...program import ScalarProgram, called_names
from ...reader import emitted_form
from .arrays.calls import results_by_numpy, write_call
from .code import NAMES, Code, Module, NotNative
from .lanes import Array, Rows
from .straight.products import product_by_numpy
from .straight.repeats import repeated_by_numpy, with_functions
from .trigonometry import sines_and_cosines

#: Kernels call no library: more is unrolled than for XLA.
NATIVE_LIMITS = Limits(pivoted=8, table=64, equations=100_000)
_WITH_PRODUCTS = dataclasses.replace(NATIVE_LIMITS, products=0)

#: The value of an entry of an argument.
Read: TypeAlias = Callable[[int, int], str]

#: A function that perturbs values as another order of operations may round them.
Rounded: TypeAlias = Callable[[NDArray[Any]], NDArray[Any]]

#: Functions of many instructions each, and how many of them are written where they are computed, which runs a tenth
#: faster. LLVM puts those of one member into vectors only there.
_INLINED = {"sin", "cos", "exp", "expm1", "logistic", "tanh"}
_MOST_INLINED = 100

#: Computed several at a time, by `sines_and_cosines`.
TURNING = (OPERATIONS["sin"], OPERATIONS["cos"])


def native_form(program: ScalarProgram, *, products: bool = False) -> ScalarProgram:
    """The program in the form from which kernels are written.

    Args:
        products: whether products of matrices that are calls stay calls, as `Straight` takes them.
    Raises:
        NotNative: it calls functions, or has numbers or operations, that have no native form, or grows too large.
    """
    try:
        form = (
            emitted_form(with_functions(program), _WITH_PRODUCTS) if products else emitted_form(program, NATIVE_LIMITS)
        )
    except TooLarge as error:
        raise NotNative(str(error).splitlines()[0]) from error
    g = form.graph
    if foreign := [call for call in form.calls if not is_loop(call) and kernel_of(call) is None]:
        raise NotNative(f"{called_names(foreign)} has no native form")
    if form.calls and _turns_products(form):
        return native_form(program)
    for i in form.live:
        if g.dtypes[i] not in NAMES:
            raise NotNative(f"{g.dtypes[i]} has no native form")
        operation = g.operation(i)
        if operation is not None:
            _form_of(operation, g.dtypes[g.arguments(i)[-1]])
    if g.dtype not in (np.float32, np.float64):
        raise NotNative(f"{g.dtype} has no native form")
    return form


def _turns_products(form: ScalarProgram) -> bool:
    """Whether a sine, a cosine or a call of a kernel, all in the first piece, depends on a product of matrices."""
    g, dependent = form.graph, set[int]()
    for i in form.live:
        is_product = g.call_of(i) is not None and kernel_of(g.call_of(i)) is None
        if is_product or not dependent.isdisjoint(g.sources(i)):
            dependent.add(i)
            if g.operation(i) in TURNING or kernel_of(g.call_of(i)) is not None:
                return True
    return False


def _form_of(operation: Operation, dtype: np.dtype[Any]) -> Callable[..., str]:
    """The LLVM form of an operation on arguments of a type."""
    form: Callable[..., str] | None = operation.llvm.of(dtype)
    if form is None:
        raise NotNative(f"{operation.name} of {NAMES[dtype]} has no native form")
    return form


class Scalars:
    """The values of a program's nodes in one function, each computed once.

    Attributes:
        values: those that are known, by node.
    """

    def __init__(self, code: Code, form: ScalarProgram, read: Read) -> None:
        self._code = code
        self._graph = form.graph
        self._read = read
        self.values: dict[int, str] = {}

    def compute(self, nodes: Sequence[int]) -> list[str]:
        """The values of nodes; independent sines and cosines are computed together."""
        g, values, live = self._graph, self.values, self._graph.live(nodes, self.values)
        for angles in self._angles(live):
            self._in_order(g.live(angles, values))
            pairs = sines_and_cosines(self._code, NAMES[g.dtypes[angles[0]]], [values[i] for i in angles])
            self._code.sines.update(zip((values[i] for i in angles), pairs, strict=True))
        self._in_order(live)
        return [values[i] for i in nodes]

    def in_piece(self, nodes: Sequence[int]) -> None:
        """The values of nodes of a piece, whose `values` are set; sines and cosines stand in the first piece."""
        if any(self._graph.operation(i) in TURNING for i in nodes):
            self.compute(nodes)
        self._in_order(nodes)

    def value(self, node: int) -> str:
        """The value of a node that is computed, a number, or an entry of an argument."""
        g = self._graph
        if node not in self.values and g.operation(node) is None and g.call_of(node) is None:
            self._in_order([node])
        return self.values[node]

    def _in_order(self, nodes: Sequence[int]) -> None:
        g, values = self._graph, self.values
        for i in nodes:
            if i in values:
                continue
            place, operation, arguments, call = g.input_of(i), g.operation(i), g.arguments(i), g.call_of(i)
            if place is not None:
                values[i] = self._read(*place)
            elif call is not None:
                for node, value in write_call(self._code, g, call, list(map(self.value, call.sources))).items():
                    values[node] = value
            elif operation is None:
                values[i] = self._code.constant(NAMES[g.dtypes[i]], g.numbers[i])
            else:
                dtype = g.dtypes[arguments[-1]]
                values[i] = _form_of(operation, dtype)(self._code, NAMES[dtype], *map(self.value, arguments))

    def _angles(self, live: Sequence[int]) -> list[list[int]]:
        """The angles of sines and cosines to come, of one precision each: first those that depend on no other of them,
        and so on.
        """
        g = self._graph
        depth: dict[int, int] = {}
        by_depth: dict[tuple[int, str], dict[int, None]] = {}
        for i in live:
            if i in self.values:
                continue
            arguments = g.arguments(i)
            depth[i] = max((depth.get(a, 0) for a in g.sources(i)), default=0)
            if g.operation(i) in TURNING and self.values.get(arguments[0]) not in self._code.sines:
                by_depth.setdefault((depth[i], g.dtypes[i].name), {})[arguments[0]] = None
                depth[i] += 1
        return [list(by_depth[k]) for k in sorted(by_depth)]


# ---- kernel bodies----------------------------------------------------------------------------------------------------


class BatchFunction(ABC):
    """A function `tile(last, arguments, results)` of the rows 0 to `last` of arrays, at most as many as a vector has
    lanes.

    Attributes:
        lanes: rows computed side by side.
        arguments, results: all of them, of one row.
        read, written: the places of those that are needed and not empty.
        chunk: rows that a thread takes at a time, a multiple of the lanes.
        in_place: results that stand where an argument stood, and that argument: what is not written stays.
    """

    in_place: Mapping[int, int] = {}

    def __init__(self, lanes: int, arguments: list[Array], results: list[Array], needed: Collection[int]) -> None:
        self.lanes = lanes
        self.arguments, self.results = arguments, results
        self.read = [k for k, array in enumerate(arguments) if array.size and k in needed]
        self.written = [k for k, array in enumerate(results) if array.size]
        self.chunk = lanes

    @property
    def arrays(self) -> dict[str, Array]:
        """The arrays that are read and written, by their names in kernels."""
        arguments = {f"a{k}": self.arguments[k] for k in self.read}
        return arguments | {f"r{k}": self.results[k] for k in self.written}

    @abstractmethod
    def write(self, module: Module) -> None:
        """Add the function, and the functions that it calls."""

    def _heads(self, pointer: str) -> str:
        return "".join(f", {pointer} %{name}, i64 %{name}.stride" for name in self.arrays)


class KernelBody(BatchFunction):
    """The function of a scalar program in a kernel.

    Attributes:
        program: from `native_form`, or a function of matrices in its form.
        tried: the length that long arrays have where the function is checked.
        packed: the bits of vectors into which LLVM is to put operations of one member; 0: it is not.
    """

    tried, packed = 0, 0

    def __init__(
        self, program: Any, lanes: int, arguments: list[Array], results: list[Array], needed: set[int]
    ) -> None:
        super().__init__(lanes, arguments, results, needed)
        self.program = program

    def write(self, module: Module) -> None:
        module.packed = self.packed if self.lanes == 1 else 0
        functions = sum(count for name, count in self.program.counts().items() if name in _INLINED)
        on_device = bool(module.processor.triple)  # where calls cost more
        module.calls = functions > _MOST_INLINED and not module.packed and not on_device
        code = Code(module, self.lanes)
        self.body(code, self._moved(code))
        module.functions["tile"] = code.function(f"internal void @tile(i64 %last{self._heads('ptr noalias')})")

    def _moved(self, code: Code) -> dict[str, Rows]:
        """The rows of all arrays, in a function that has their heads."""
        places = ["0"]  # the row of a lane: its own, or the last one where there are fewer rows than lanes
        for lane in range(1, self.lanes):
            places.append(code.call("i64", "llvm.umin.i64", ("i64", "%last"), ("i64", str(lane))))
        rows = dict[str, Rows]()
        for name, array in self.arrays.items():
            stride = f"%{name}.stride"  # entries from one row to the next; zero where all lanes share one
            starts = [code.emit(f"mul nuw nsw i64 {place}, {stride}") for place in places]
            pointers = [code.emit(f"getelementptr {array.stored}, ptr %{name}, i64 {start}") for start in starts]
            rows[name] = Rows(code, array, pointers, stride if code.module.by_columns else "1")
        return rows

    @abstractmethod
    def body(self, code: Code, rows: Mapping[str, Rows]) -> None:
        """Add the instructions.

        Args:
            rows: those of `arrays`.
        """

    @abstractmethod
    def plain(self, arguments: Sequence[NDArray[Any]], rounded: Rounded = np.asarray) -> list[NDArray[Any]]:
        """All results by NumPy, for all arguments, (rows, entries) each; `rounded` is applied to each number met."""

    def exercised(self, arguments: list[NDArray[Any]]) -> list[NDArray[Any]]:
        """Random arguments, changed so that all parts of the function are exercised."""
        return arguments


def _called_by_numpy(rounded: Rounded, call: OpaqueCall, values: dict[int, NDArray[Any]]) -> dict[int, NDArray[Any]]:
    """The results of a call, of a product of matrices or of a kernel."""
    if isinstance(call.key, RepeatedMembers):
        results = repeated_by_numpy(call, values, functools.partial(by_numpy, rounded=rounded))
    else:
        results = product_by_numpy(call, values) if kernel_of(call) is None else results_by_numpy(call, values)
    return {i: rounded(value) for i, value in results.items()}


def arguments_of(program: ScalarProgram) -> list[Array]:
    return [Array(a.shape, program.graph.dtype_of(a)) for a in program.inputs]


def needed_by(program: ScalarProgram) -> set[int]:
    """The arguments that a program reads."""
    return {place[0] for i in program.live if (place := program.graph.input_of(i)) is not None}


def by_numpy(
    program: ScalarProgram, arguments: Sequence[NDArray[Any]], rounded: Rounded = np.asarray
) -> list[NDArray[Any]]:
    """The results for rows of arguments, (rows, entries) each, by NumPy: the reference for kernels."""
    count = len(arguments[0]) if arguments else 1
    with np.errstate(all="ignore"):
        values = program.computed(
            lambda argument, place: arguments[argument][:, place],
            lambda value, dtype: rounded(np.full(count, value, dtype)),
            lambda operation, i, *a: rounded(np.asarray(operation.number(*a)).astype(program.graph.dtypes[i])),
            functools.partial(_called_by_numpy, rounded),
        )
    return [
        np.stack([values[i] for i in flat(nodes)], 1) if nodes.size else np.zeros((count, 0), dtype)
        for nodes, dtype in zip(program.outputs, program.types, strict=True)
    ]
