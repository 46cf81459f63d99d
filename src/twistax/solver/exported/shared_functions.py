"""Elementary functions, such as sines, that values and derivatives of a function contain: each is computed once."""

from __future__ import annotations

from ...scalar.primitives.entry import Select
from ...scalar.primitives.interface import flat, nodes
from ...scalar.primitives.operations import OPERATIONS
from ...scalar.program import ScalarProgram
from ...scalar.reader import JaxprReader, rebuilt

#: Operations that take longer than a load of their result.
_ELEMENTARY = {"pow", "atan2", "cbrt", "exp", "exp2", "expm1", "log", "log1p", "logistic", "sin", "cos", "tan"} | {
    *("asin", "acos", "atan", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh")
}
#: The function in the derivative of another one; the other derivatives contain the function itself, or are algebraic.
_DERIVATIVES = {"sin": "cos", "cos": "sin", "sinh": "cosh", "cosh": "sinh"}


class SharedFunctions:
    """The elementary functions in a program that computes values.

    Args:
        program: without calls.

    Attributes:
        width: how many there are.
    """

    def __init__(self, program: ScalarProgram) -> None:
        self._program, graph = program, program.graph
        places = dict[int, int]()
        for node in _elementary(program, len(program.inputs)):
            places.setdefault(node, len(places))
            operation = graph.operation(node)
            if operation is not None and operation.name in _DERIVATIVES:
                other = OPERATIONS[_DERIVATIVES[operation.name]].on(graph)
                places.setdefault(other(*graph.arguments(node)), len(places))
        self._places, self.width = places, len(places)

    @property
    def program(self) -> ScalarProgram:
        """Computes the functions of the arguments: a vector."""
        vector = nodes(self._places, (self.width,))
        return rebuilt(self._program.restricted([vector]), set(), True, self._program.graph.limits)

    def read_by(self, program: ScalarProgram) -> ScalarProgram:
        """A program with the vector of the functions as its last argument.

        Args:
            program: without calls. Its first arguments are those of the program of the functions.
        """
        g, first, argument = program.graph, self._program, len(program.inputs)
        known = dict(zip(flat(*program.inputs[: len(first.inputs)]), flat(*first.inputs), strict=True))
        functions = _elementary(program, len(first.inputs))
        JaxprReader(first.graph).copy(program.restricted([nodes(functions, (len(functions),))]), known)
        of_place = {self._places[known[node]]: node for node in functions if known[node] in self._places}
        entries = [of_place[k] if k in of_place else g.input(argument, k, g.dtype) for k in range(self.width)]
        inputs = (*program.inputs, nodes(entries, (self.width,)))
        return rebuilt(ScalarProgram(g, inputs, program.outputs, program.types), set(), True, g.limits)


def _elementary(program: ScalarProgram, arguments: int) -> list[int]:
    """The elementary functions in a program that depend on its first arguments only.

    A function that only one side of a selection needs is none of them: compilers of C compute it on that side alone.
    """
    g, always, computable = program.graph, _always_needed(program), set(flat(*program.inputs[:arguments]))
    result = list[int]()
    for node in program.live:
        operation = g.operation(node)
        if g.input_of(node) is None and computable.issuperset(g.sources(node)):
            computable.add(node)
            if operation is not None and operation.name in _ELEMENTARY and node in always:
                result.append(node)
    return result


def _always_needed(program: ScalarProgram) -> set[int]:
    """The nodes that the results need whatever is selected."""
    g, needed, waiting = program.graph, set[int](), list(program.flat)
    while waiting:
        node = waiting.pop()
        if node not in needed:
            needed.add(node)
            operation, sources = g.operation(node), g.sources(node)
            waiting.extend(sources[:1] if isinstance(operation, Select) else sources)
    return needed
