"""What a program computes from one of its arguments alone, apart: once where that argument stays as it is."""

from __future__ import annotations

from .graph import Graph
from .primitives.entry import Nodes, flat, nodes
from .primitives.operations import OPERATIONS
from .reader import Reader, ScalarProgram, _copy, _rebuilt, _renamed

_DIV = OPERATIONS["div"]


def computed_before(program: ScalarProgram, argument: int) -> tuple[ScalarProgram, ScalarProgram]:
    """What depends on one argument alone as a program, and the program that takes its results in that argument's place.

    What is divided by such numbers is multiplied by their inverses.

    Args:
        program: one without calls.
    """
    divisors = _alone(program, argument)
    divided = (program.graph.arguments(i) for i in program.live if program.graph.operation(i) is _DIV)
    shared = {own[1] for own in divided if own[1] in divisors and own[0] not in divisors}
    program = _rebuilt(program, shared, True, program.graph.limits) if shared else program
    old, alone = program.graph, _alone(program, argument)
    rest = [i for i in program.live if i not in alone]
    read = {a for i in rest for a in old.arguments(i)} | set(program.flat)
    ends = nodes(sorted(alone & read), (len(alone & read),))
    before = _rebuilt(program.restricted([ends]), set(), True, old.limits)
    new = Graph(old.dtype, old.checked, old.largest, old.limits, old.signed_zeros)
    sources = [*program.inputs[:argument], ends, *program.inputs[argument + 1 :]]
    inputs, known = list[Nodes](), dict[int, int]()
    for k, own in enumerate(sources):
        inputs.append(nodes([new.input(k, j, old.dtypes[i]) for j, i in enumerate(flat(own))], own.shape))
        known.update(zip(flat(own), flat(inputs[k]), strict=True))
    _copy(program, Reader(new), known, order=rest)
    outputs = tuple(_renamed(known, own) for own in program.outputs)
    return before, ScalarProgram(new, tuple(inputs), outputs, program.types)


def _alone(program: ScalarProgram, argument: int) -> set[int]:
    """The nodes that are needed and depend on an argument and on no other."""
    g, found = program.graph, set[int]()
    for i in program.live:
        place = g.input_of(i)
        sources = [j for j in g.sources(i) if g.operation(j) is not None or g.input_of(j) is not None]
        if (place is not None and place[0] == argument) or (sources and found.issuperset(sources)):
            found.add(i)
    return found
