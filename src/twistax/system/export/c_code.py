"""C99 code of a compiled system: names, header and source."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from string import Template
from typing import Any

from numpy.typing import NDArray

from ...errors import ModelError
from ...scalar.kernel_cache import version
from ...scalar.targets.c import CType, c_type
from .programs import ExportedFunction, Exporter, Port
from .statements import Definitions, Statements

#: How every file begins, by which files that may be replaced are known.
MARK = "/* Written by twistax"

_MEANINGS = {
    "t": "time",
    "x": "state {}",
    "u": "control {}",
    "params": "parameter {}",
    "rate": "rate of {}",
    "output": "output {}",
    "inequality": "what must be <= 0",
    "equality": "what must be = 0",
    "h": "length of the step",
    "P": "covariance {} the call, of d in x Exp(d), states in the order of the arguments",
    "z": "measured value of {}",
    "nis": "normalised innovation squared of {}",
    "next": "state {} at the end",
    "by x": "by right perturbations of the states, x (+) d = x Exp(d)",
    "by u": "by entries of the controls",
    "by params": "by entries of the parameters",
}


def mark() -> str:
    """The first line of generated files."""
    return f"{MARK} {version()}"


def filled(template: str, **parts: Any) -> str:
    """A template of this folder with its placeholders filled in."""
    return Template(Path(__file__).with_name(template).read_text()).substitute(parts)


def identifiers(ports: Sequence[Port]) -> dict[Port, str]:
    """The C name of each array: a prefix for its kind, and its name with underscores in place of characters that C does
    not allow.

    Letters beyond ASCII are replaced by their numbers: u03c9.

    Raises:
        ModelError: two arrays get the same name.
    """
    ports_by_name: dict[str, Port] = {}
    for port in ports:
        plain = re.sub(r"[^\x00-\x7f]", lambda letter: f"u{ord(letter[0]):04x}", port.name)
        # Its kind keeps a name apart from C's words and from libm's.
        kind = {"jacobian": "by", "params": "p"}.get(port.kind, port.kind)
        name = kind if port.by_value else f"{kind}_{re.sub(r'[^A-Za-z0-9_]', '_', plain)}"
        if name in ports_by_name:
            raise ModelError(
                f"{ports_by_name[name].name!r} and {port.name!r} would both have the name {name} in C.\n"
                "  fix: rename one"
            )
        ports_by_name[name] = port
    return {port: name for name, port in ports_by_name.items()}


@dataclasses.dataclass(frozen=True)
class CCode:
    """The C code of a compiled system."""

    name: str  # of the files, and what the names of all functions begin with
    exporter: Exporter
    functions: Sequence[ExportedFunction]
    names: Mapping[Port, str]  # of all arrays
    real: CType  # of all numbers

    def header(self) -> str:
        """The text of the header: interface and declarations."""
        constants = "".join(f"extern {head};\n" for head in self._defaults())
        if constants:
            constants = f"/* The parameters' own values, to pass where no others are wanted. */\n{constants}\n"
        heads = [*map(self._head, self.functions), *(loop.head for loop in self._loops())]
        prototypes = "\n".join(f"{head};\n" for head in heads)
        return filled(
            "header.h.in",
            mark=mark(),
            real=self.real.name,
            arguments=self._listed(self.exporter.arguments),
            results="".join(map(self._results, self.functions)) + "".join(loop.comment for loop in self._loops()),
            guard=f"{self.name}_H",  # as written: in C, names that differ in case differ
            constants=constants,
            prototypes=prototypes,
        )

    def source(self) -> str:
        """The text of the source file."""
        definitions = Definitions()
        bodies = [
            f"{self._head(function)}\n{{\n{body(function, self.exporter.arguments, self.names, definitions)}}}\n"
            for function in self.functions
        ]
        bodies += [loop.text for loop in self._loops()]
        parts = [
            f'{mark()}. The call convention stands in {self.name}.h. */\n#include "{self.name}.h"\n\n'
            "#include <math.h>\n#include <stdbool.h>\n#include <stdint.h>\n#include <string.h>\n",
            "".join(f"{head} = {{{values}}};\n" for head, values in self._defaults().items()),
            *(numbers(table.name, table.numbers(self.real.dtype), self.real) for table in definitions.tables),
            *definitions.functions,
            *bodies,
        ]
        return "\n".join(part for part in parts if part)

    def _loops(self) -> list[StepLoop]:
        return [StepLoop(self, function) for function in self.functions if function.name == "step"]

    def _head(self, function: ExportedFunction) -> str:
        """The head of a function, without what follows it."""
        return self.head_of(function.name, function, [])

    def head_of(self, name: str, function: ExportedFunction, counts: Sequence[str]) -> str:
        """The declaration of a function with the arguments and results of another one, and counts before the
        results.
        """
        real, names = self.real.name, self.names
        listed = [
            f"{real} {names[port]}" if port.by_value else f"const {real} *{names[port]}"
            for port in (*self.exporter.arguments, *function.extra)
        ]
        listed += [*(f"int32_t {count}" for count in counts), *(f"{real} *{names[port]}" for port in function.results)]
        return f"void {self.name}_{name}(\n    " + ",\n    ".join(listed) + ")"

    def _defaults(self) -> dict[str, str]:
        """The parameters that have values of their own: head -> these, row by row."""
        defaults = {p.name: p.value for p in self.exporter.dynamics.parameters if p.value is not None}
        return {
            f"const {self.real.name} {self.name}_default_{self.names[port]}[{port.size}]": ", ".join(
                self.real.literal(self.real.dtype.type(v)) for v in defaults[port.name].reshape(-1)
            )
            for port in self.exporter.arguments
            if port.kind == "params" and port.name in defaults and port.size
        }

    def _listed(self, ports: Sequence[Port]) -> str:
        rows = [(self.names[p], " x ".join(map(str, p.shape)) or "1", self._meaning(p)) for p in ports]
        width, room = (max(len(row[k]) for row in rows) for k in (0, 1))
        return "".join(f" *   {a:<{width}}  {b:<{room}}  {c}".rstrip() + "\n" for a, b, c in rows)

    def _meaning(self, port: Port) -> str:
        kind = {"constraint": port.name, "jacobian": f"by {port.name}"}.get(port.kind, port.kind)
        text = _MEANINGS[kind].format(_comment(port.name))
        groups = {state.name: state.group for state in self.exporter.dynamics.states}
        if kind not in ("x", "rate") or groups[port.name].flat:
            return text
        return text + (f", an element of {_comment(groups[port.name].name)}" if kind == "x" else ", a body velocity")

    def _results(self, function: ExportedFunction) -> str:
        text = f" *\n * Results of {function.name}, in this order\n{self._listed(function.results)}"
        if function.extra:
            text += " *   After the parameters it takes\n"
            for port in function.extra:
                text += f" *     the {self._meaning(port)}, {self.names[port]}{', by value' if port.by_value else ''}\n"
            text += " *   Controls stay constant.\n"
        if function.name == "jacobian":
            rows = ", ".join(_comment(state.name) for state in self.exporter.dynamics.states)
            places = sum(port.size for port in function.results)
            written = sum(int((nodes != function.program.graph.zero).sum()) for nodes in function.program.outputs)
            text += (
                f" *   Rows: the rates of {rows}, one after the other, entries row by row; columns likewise, in the\n"
                f" *   order of the arguments. {written} of {places} entries may differ from zero.\n"
            )
        return text


@dataclasses.dataclass(frozen=True)
class StepLoop:
    """The C function that takes n successive steps."""

    code: CCode
    step: ExportedFunction

    @property
    def head(self) -> str:
        return self.code.head_of("simulate", self.step, ["n"])

    @property
    def comment(self) -> str:
        return (
            " *\n * simulate takes n steps of length h, beginning at time t, and gives what the last step gives;\n"
            " *   of n <= 0 the states at the beginning. Controls stay constant over all of them.\n"
        )

    @property
    def text(self) -> str:
        code, names, real = self.code, self.code.names, self.code.real.name
        states = {port.name: port for port in code.exporter.arguments if port.kind == "x"}
        pairs = [(names[states[port.name]], names[port], port.size) for port in self.step.results]
        memory = [f"{real} from_{after}[{size}];" for _, after, size in pairs]
        begin = [f"memcpy({after}, {before}, sizeof from_{after});" for before, after, _ in pairs]
        again = [f"memcpy(from_{after}, {after}, sizeof from_{after});" for _, after, _ in pairs]
        moved = {before: f"from_{after}" for before, after, _ in pairs}
        arguments = [names[port] for port in (*code.exporter.arguments[1:], *self.step.extra, *self.step.results)]
        listed = ", ".join([f"t + ({real})k * h", *(moved.get(name, name) for name in arguments)])
        loop = [*again, f"{code.name}_step({listed});"]
        lines = [*memory, *begin, "for (int32_t k = 0; k < n; k++) {", *(f"    {line}" for line in loop), "}"]
        return f"{self.head}\n{{\n" + "".join(f"    {line}\n" for line in lines) + "}\n"


def body(
    function: ExportedFunction,
    arguments: Sequence[Port],
    names: Mapping[Port, str],
    definitions: Definitions | None = None,
) -> str:
    """The lines of a function.

    Args:
        definitions: to which the tables and functions that it needs are added.
    Raises:
        ModelError: a type that C does not have, or that lacks an operation.
    """
    program, g, every = function.program, function.program.graph, [*arguments, *function.extra]
    lines = Statements(definitions or Definitions())
    used: set[int] = set()

    def entry(argument: int, place: int) -> str:
        used.add(argument)
        port = every[argument]
        return names[port] if port.by_value else f"{names[port]}[{place}]"

    values = lines.computed(program, entry)
    unused = [f"(void){names[port]};" for k, port in enumerate(every) if k not in used]
    results = []
    for port, nodes in zip(function.results, program.outputs, strict=True):
        for k, i in enumerate(nodes.reshape(-1).tolist()):
            cast = "" if g.dtypes[i] == g.dtype else f"({c_type(g.dtype).name})"
            results.append(f"{names[port]}[{k}] = {cast}{values[i]};")
    return "".join(f"    {line}\n" for line in (*unused, *lines.lines, *results))


def numbers(name: str, values: NDArray[Any], real: CType) -> str:
    """An array of constants."""
    entries = [real.literal(v) for v in values.astype(real.dtype).reshape(-1)]
    lines = [", ".join(entries[k : k + 6]) for k in range(0, len(entries), 6)]
    return f"static const {real.name} {name}[{len(entries)}] = {{\n    " + ",\n    ".join(lines) + "\n};\n"


def _comment(text: str) -> str:
    """Text made safe for a comment, whatever names a user chose."""
    return re.sub(r"[^ -~]|[*/\\?]", "_", text)
