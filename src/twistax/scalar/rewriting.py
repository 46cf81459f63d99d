"""Rewritten scalar programs: in the form of emitters, in another order, or with a part computed before."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

from .graph import LIMITS, ScalarGraph
from .primitives.interface import Limits, Nodes, flat, nodes
from .primitives.operations import OPERATIONS
from .program import ScalarProgram
from .reader import JaxprReader, renamed

_DIV = OPERATIONS["div"]


def emitted_form(program: ScalarProgram, limits: Limits = LIMITS) -> ScalarProgram:
    """The program that an emitter writes: calls that are functions of scalars are unrolled, and x / d, y / d, ...
    become products with one 1 / d, unless the program is checked.

    A shared reciprocal costs one more rounding, half a unit in the last place.

    Args:
        limits: up to which size parts are unrolled; larger for emitters that cannot call a library.
    """
    unrolled = program.calls or any(o.written for i in program.live if (o := program.graph.operation(i)) is not None)
    expanded = rebuilt(program, set(), keep_calls=False, limits=limits) if unrolled else program
    if program.graph.checked:
        return expanded
    g = expanded.graph
    uses = Counter(g.arguments(i)[1] for i in expanded.live if g.operation(i) is _DIV and g.dtypes[i] == g.dtype)
    shared = {divisor for divisor, count in uses.items() if count > 1}
    return rebuilt(expanded, shared, keep_calls=False, limits=limits) if shared else expanded


def one_by_one(
    program: ScalarProgram, first: Iterable[int] = (), substitutes: Mapping[int, Nodes] | None = None
) -> ScalarProgram:
    """The program in another order: result by result, each with the nodes that it needs in addition.

    Derivatives along many tangents come side by side. In this order compilers keep fewer numbers at a time, and pieces
    of the program need fewer of one another.

    Args:
        first: nodes that come before the results, in their order.
        substitutes: arguments that are no inputs any more -> nodes that stand for them and do not depend on them.
    """
    order = program.graph.one_by_one([*first, *program.flat])
    return rebuilt(program, set(), True, program.graph.limits, order, substitutes)


def rebuilt(
    program: ScalarProgram,
    shared: set[int],
    keep_calls: bool,
    limits: Limits,
    order: Sequence[int] | None = None,
    substitutes: Mapping[int, Nodes] | None = None,
) -> ScalarProgram:
    """The program in a new graph.

    Args:
        shared: divisors of which the reciprocal is taken once.
        keep_calls: whether calls stay calls.
        order: of the nodes; as they are if None.
        substitutes: arguments that are no inputs any more -> nodes that stand for them, computed first.
    """
    old, substitutes = program.graph, substitutes or {}
    new = ScalarGraph(old.dtype, old.checked, old.largest, limits, old.signed_zeros)
    inputs: list[Nodes] = []
    known: dict[int, int] = {}
    for array in (a for k, a in enumerate(program.inputs) if k not in substitutes):
        entries = [new.input(len(inputs), j, old.dtypes[i]) for j, i in enumerate(flat(array))]
        known.update(zip(flat(array), entries, strict=True))
        inputs.append(nodes(entries, array.shape))
    reader = JaxprReader(new, keep_calls)
    if substitutes:
        reader.copy(program.restricted(list(substitutes.values())), known, shared)
    for k, array in substitutes.items():
        known.update(zip(flat(program.inputs[k]), (known[i] for i in flat(array)), strict=True))
    reader.copy(program, known, shared, order)
    outputs = tuple(renamed(known, array) for array in program.outputs)
    return ScalarProgram(new, tuple(inputs), outputs, program.types)


def computed_before(program: ScalarProgram, argument: int) -> tuple[ScalarProgram, ScalarProgram]:
    """What depends on one argument alone as a program, and the program that takes its results in that argument's place.

    What is divided by such numbers is multiplied by their inverses.

    Args:
        program: one without calls.
    """
    divisors = _alone(program, argument)
    divided = (program.graph.arguments(i) for i in program.live if program.graph.operation(i) is _DIV)
    shared = {b for a, b in divided if b in divisors and a not in divisors}
    program = rebuilt(program, shared, True, program.graph.limits) if shared else program
    old, alone = program.graph, _alone(program, argument)
    rest = [i for i in program.live if i not in alone]
    read = {a for i in rest for a in old.arguments(i)} | set(program.flat)
    ends = nodes(sorted(alone & read), (len(alone & read),))
    before = rebuilt(program.restricted([ends]), set(), True, old.limits)
    new = ScalarGraph(old.dtype, old.checked, old.largest, old.limits, old.signed_zeros)
    sources = [*program.inputs[:argument], ends, *program.inputs[argument + 1 :]]
    inputs, known = list[Nodes](), dict[int, int]()
    for k, array in enumerate(sources):
        inputs.append(nodes([new.input(k, j, old.dtypes[i]) for j, i in enumerate(flat(array))], array.shape))
        known.update(zip(flat(array), flat(inputs[k]), strict=True))
    JaxprReader(new).copy(program, known, order=rest)
    outputs = tuple(renamed(known, array) for array in program.outputs)
    return before, ScalarProgram(new, tuple(inputs), outputs, program.types)


def _alone(program: ScalarProgram, argument: int) -> set[int]:
    """The needed nodes that depend on one argument and on no other."""
    g, dependent = program.graph, set[int]()
    for i in program.live:
        place = g.input_of(i)
        sources = [j for j in g.sources(i) if g.operation(j) is not None or g.input_of(j) is not None]
        if (place is not None and place[0] == argument) or (sources and dependent.issuperset(sources)):
            dependent.add(i)
    return dependent
