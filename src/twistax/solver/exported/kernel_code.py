"""Kernels as C99 functions with the calling convention of the core's machine code: a table of addresses and strides."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from numpy import ndarray as Array

from ...errors import ModelError, TrajectoryError
from ...scalar.program import ScalarProgram, called_names
from ...scalar.reader import emitted_form
from ...scalar.targets.c import CType, c_type
from ...system.export.c_code import numbers
from ...system.export.control_flow import LIMITS, foreign_calls
from ...system.export.statements import Definitions, Statements
from ...system.hessian import REFUSALS
from ..kernels import Argument, BatchKernel, ScalarForm
from .shared_functions import SharedFunctions

#: Of a function whose result is zero.
NO_KERNEL = "{NULL, 0, {0}, NULL}"


class KernelCode:
    """The C functions of kernels, each written once.

    Args:
        real: the type of their numbers.

    Attributes:
        functions: their text, in the order in which they were asked for.
        operations: of a row of each kernel, by its number and name. Kernels with the same code share a function.
    """

    def __init__(self, real: CType) -> None:
        self._real = real
        self.functions, self.operations = list[str](), dict[str, int]()
        self._definitions, self._functions = Definitions(), dict[str, str]()

    def structure(self, kernel: BatchKernel | None, what: str) -> str:
        """The initialiser of a `twx_kernel`.

        Args:
            what: for names and messages, such as "rate_slopes".
        Raises:
            TrajectoryError: the function has no scalar form.
        """
        return self.written(None if kernel is None else self._scalar_form(kernel, what), what)

    def sharing(self, kernels: Mapping[str, BatchKernel]) -> tuple[list[str], int]:
        """The initialisers of kernels that compute common elementary functions once: those of the kernels, and that of
        the functions, whose number is the second result.

        Args:
            kernels: of the values, then of derivatives, by name.
        """
        forms = [self._scalar_form(kernel, what) for what, kernel in kernels.items()]
        functions = None if forms[0] is None else SharedFunctions(forms[0].program)
        of_functions, width = None, 0
        if forms[0] is not None and functions is not None and functions.width:
            of_functions, width = forms[0]._replace(program=functions.program), functions.width
            forms = [form and _reading(functions, form) for form in forms]
        names = [*kernels, f"{next(iter(kernels))}_functions"]
        return [self.written(form, what) for form, what in zip([*forms, of_functions], names, strict=True)], width

    def _scalar_form(self, kernel: BatchKernel, what: str) -> ScalarForm | None:
        """The program of a kernel; None if its result is zero.

        Raises:
            TrajectoryError: the function has no scalar form.
        """
        if kernel.structure.run is None:
            return None
        if kernel.written is None:
            raise TrajectoryError(f"to_c: {what} has no scalar form")
        try:
            form = kernel.written(self._real.dtype)
            form = form._replace(program=emitted_form(form.program, LIMITS))
            if foreign := foreign_calls(form.program, loops=True):
                raise ModelError(f"it calls {called_names(foreign)}")
        except (*REFUSALS, ModelError) as error:
            raise TrajectoryError(
                f"to_c: {what} has no scalar form: {error}\n"
                "  fix: use nodes, without JAX functions that call a library or the host"
            ) from error
        return form

    def written(self, form: ScalarForm | None, what: str) -> str:
        """The initialiser of a `twx_kernel`, whose function is written; None: its result is zero."""
        if form is None:
            return NO_KERNEL
        program, arguments, values = form
        name = f"kernel_{len(self.operations)}_{what}"
        used, text = _function(name, program, self._real.name, self._definitions)
        function = self._functions.setdefault(text.replace(name, ""), name)
        if function == name:
            self.functions.append(text)
        self.operations[name] = program.operations
        constants = "NULL"
        if len(values) and Argument.NUMBERS in (arguments[k] for k in used):
            constants = f"{name}_numbers"
            self.functions.append(numbers(constants, values, self._real))
        places = ", ".join(str(int(arguments[k])) for k in used)
        return f"{{{function}, {len(used)}, {{{places or 0}}}, {constants}}}"

    @property
    def text(self) -> str:
        """All functions, after the tables and functions that they need."""
        tables = [
            numbers(table.name, table.numbers(self._real.dtype), self._real) for table in self._definitions.tables
        ]
        return "\n".join([*tables, *self._definitions.functions, *self.functions])


def _reading(functions: SharedFunctions, form: ScalarForm) -> ScalarForm:
    return form._replace(program=functions.read_by(form.program), arguments=[*form.arguments, Argument.SHARED])


def _function(name: str, program: ScalarProgram, real: str, definitions: Definitions) -> tuple[list[int], str]:
    """The arguments that are read, and the text; the tables and functions that it needs are added."""
    lines, used = Statements(definitions), list[int]()

    def entry(argument: int, place: int) -> str:
        if argument not in used:
            used.append(argument)
        return f"a{argument}[{place}]"

    values = lines.computed(program, entry)
    results = [f"out[{k}] = {values[node]};" for k, node in enumerate(program.flat)]
    return used, _loop(name, used, [*lines.lines, *results], real)


def _loop(name: str, used: Sequence[int], lines: Sequence[str], real: str) -> str:
    count = len(used)
    rows = [
        f"const {real} *const a{argument} = (const {real} *)(intptr_t)table[{k}] + row * table[{count + 1 + k}];"
        for k, argument in enumerate(used)
    ]
    rows.append(f"{real} *const out = ({real} *)(intptr_t)table[{count}] + row * table[{2 * count + 1}];")
    inner = "".join(f"    {line}\n" for line in (*rows, *lines))
    head = f"static void {name}(const int64_t *table, int64_t first, int64_t end)"
    return f"{head}\n{{\n  for (int64_t row = first; row < end; row++) {{\n{inner}  }}\n}}\n"


def array(name: str, values: Array, real: CType) -> str:
    """A constant array of numbers or whole numbers."""
    if values.dtype == float:
        return numbers(name, values, real)
    kind: Any = c_type(values.dtype)
    entries = [str(int(v)) for v in values.ravel()]
    lines = [", ".join(entries[k : k + 16]) for k in range(0, len(entries), 16)]
    return f"static const {kind.name} {name}[{len(entries)}] = {{\n    " + ",\n    ".join(lines) + "\n};\n"
