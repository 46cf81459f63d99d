"""Reading of jaxprs into a graph of scalars, every equation on arrays of nodes; and rewriting of programs in another
graph.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..jax_inside import (
    ClosedJaxpr,
    Jaxpr,
    Literal,
    Unread,
    all_equations,
    alone,
    is_key,
    on_key_data,
)
from .graph import LIMITS, OpaqueCall, ScalarGraph
from .parts.custom_derivative import CustomDerivative
from .primitives.interface import Limits, Nodes, Repeat, RepeatedMembers, flat, nodes, stays_call
from .primitives.piecewise_constant import piecewise_constant
from .primitives.table import OPERATIONS, entry_of, say_unread
from .program import ScalarProgram

_DIV, _NEG = OPERATIONS["div"], OPERATIONS["neg"]

#: Programs of fewer operations are written out each time.
LEAST_REPEATED = 200


class JaxprReader:
    """Reads jaxprs into one graph.

    Attributes:
        graph: where the scalars go.
        keep_calls: whether functions with a custom derivative stay calls; else they are unrolled.
    """

    def __init__(self, graph: ScalarGraph, keep_calls: bool = True) -> None:
        self.graph = graph
        self.keeps_calls = keep_calls
        self._literals: dict[Any, Nodes] = {}
        self._reading: list[Jaxpr] = []

    def read(self, program: ClosedJaxpr, inputs: Sequence[Nodes]) -> list[Nodes]:
        """The results of a jaxpr on arrays of nodes. Random keys are the arrays of their numbers."""
        jaxpr, g = program.jaxpr, self.graph
        known: dict[Any, Nodes] = {}

        def value(variable: Any) -> Nodes:
            return self._literal(variable) if isinstance(variable, Literal) else known[variable]

        consts = zip(jaxpr.constvars, program.consts, strict=True)
        with jax.ensure_compile_time_eval():
            known.update((v, g.array(jax.random.key_data(c) if is_key(v) else c)) for v, c in consts)
        known.update(zip(jaxpr.invars, inputs, strict=True))
        self._reading.append(jaxpr)
        for eqn in jaxpr.eqns:
            results = self._equation(eqn, [value(v) for v in eqn.invars])
            known.update(zip(eqn.outvars, results, strict=True))
        self._reading.pop()
        return [value(v) for v in jaxpr.outvars]

    def inlined(self, program: ScalarProgram, inputs: Sequence[Nodes]) -> list[Nodes]:
        """The results of a scalar program on arrays of nodes."""
        known = dict(zip(flat(*program.inputs), flat(*inputs), strict=True))
        self.copy(program, known)
        return [renamed(known, array) for array in program.outputs]

    def repeated(self, eqn: Any, program: ScalarProgram, arguments: Sequence[Nodes]) -> list[Nodes]:
        """The results of a scalar program for rows of arguments, written out or as a call, as the limits say."""
        g, variables = self.graph, [v for v in eqn.invars if not isinstance(v, Literal)]
        distinct = len(set(variables)) == len(eqn.invars) and not eqn.params["batch"].shared
        if g.limits.products < math.inf and distinct and repeats_in_kernels(program, g):
            g.inside += len(arguments[0]) * program.operations
            function = alone(self._reading[-1], eqn, variables)
            results = [array.copy() for array in g.call(function, RepeatedMembers(program), arguments, True).results]
            for array, outputs in zip(results, program.outputs, strict=True):
                for place, node in np.ndenumerate(outputs):
                    if (number := program.graph.numbers[node]) is not None:
                        array[(slice(None), *place)] = g.constant(number, program.graph.dtypes[node])
            return results
        rows = [self.inlined(program, row) for row in zip(*arguments, strict=True)]
        results = [nodes(flat(*results), (len(rows), *results[0].shape)) for results in zip(*rows, strict=True)]
        g.repeats.append(Repeat(program, tuple(arguments), tuple(results)))
        return results

    def known(self, arrays: Iterable[Nodes]) -> bool:
        """Whether all entries of arrays are numbers."""
        return all(self.graph.values(a) is not None for a in arrays)

    def call(self, eqn: Any, arrays: Sequence[Nodes], body: ClosedJaxpr | None = None, key: Any = None) -> list[Nodes]:
        """An equation as a call of a function.

        Args:
            body: what it does, for a function that is called only because of its custom derivative.
            key: of a function without derivatives: what writes it in kernels.
        """
        distinct = {v: a for v, a in zip(eqn.invars, arrays, strict=True) if not isinstance(v, Literal)}
        equation = on_key_data(alone(self._reading[-1], eqn, list(distinct)))
        # A function that is unrolled for its derivative alone has no effects: equal functions are one call.
        key = (key or object()) if body is None else CustomDerivative(eqn.primitive.name, body, equation)
        return list(self.graph.call(equation, key, distinct.values(), body is not None).results)

    def copy(
        self,
        program: ScalarProgram,
        known: dict[int, int],
        shared: Collection[int] = (),
        order: Sequence[int] | None = None,
    ) -> None:
        """Add the nodes of a program to the graph.

        Args:
            known: node of the program -> node of this graph: at first its inputs, afterwards all that are needed.
            shared: divisors of which the reciprocal is taken once.
            order: of the nodes; as they are if None.
        """
        old, new = program.graph, self.graph
        done: set[int] = set()
        # Where inputs stay inputs there is nothing left to simplify, until a call is unrolled.
        simple = old.simplifies_as(new) and all(new.input_of(node) is not None for node in known.values())
        for i in program.live if order is None else order:
            if i in known:
                continue
            call, operation = old.call_of(i), old.operation(i)
            if call is not None:
                if id(call) not in done:
                    done.add(id(call))
                    simple = self._copy_call(call, known) and simple
            elif operation is None:
                known[i] = new.constant(old.numbers[i], old.dtypes[i])
            else:
                arguments = [known[a] for a in old.arguments(i)]
                if operation is _DIV and old.arguments(i)[1] in shared:
                    known[i] = new.mul(arguments[0], new.div(new.one, arguments[1]))
                elif operation.written is not None and not self.keeps_calls:
                    known[i] = operation.written(new)(*arguments)
                    simple = False
                elif simple:
                    known[i] = new.copied(operation, arguments, old.dtypes[i])
                else:
                    known[i] = operation.on(new)(*arguments)
        for repeat in old.repeats:
            self._copy_repeat(repeat, old, known)

    def _copy_repeat(self, repeat: Repeat, old: ScalarGraph, known: dict[int, int]) -> None:
        """Note that the new graph contains a program several times, if it needs it."""
        if any(i in known for i in flat(*repeat.results)):
            # Results may depend on what an argument is made of, and not on the argument.
            for i in old.live((i for i in flat(*repeat.arguments) if i >= 0), known):
                operation, number = old.operation(i), old.numbers[i]
                if operation is not None:
                    known[i] = operation.on(self.graph)(*(known[a] for a in old.arguments(i)))
                elif number is not None:
                    known[i] = self.graph.constant(number, old.dtypes[i])
                else:
                    return
            for i in flat(*repeat.results):
                if i not in known and old.operation(i) is _NEG and old.arguments(i)[0] in known:
                    known[i] = self.graph.neg(known[old.arguments(i)[0]])
            kept = {i: known.get(i, -1) for i in flat(*repeat.arguments, *repeat.results)}
            rows = ([renamed(kept, array) for array in arrays] for arrays in (repeat.arguments, repeat.results))
            self.graph.repeats.append(Repeat(repeat.program, *map(tuple, rows)))

    def _copy_call(self, call: OpaqueCall, known: dict[int, int]) -> bool:
        """Add what a call does; gives whether it stays a call."""
        arguments = [renamed(known, array) for array in call.arguments]
        kept = self.keeps_calls or stays_call(call, self.graph.limits)
        if kept:
            results = list(self.graph.call(call.jaxpr, call.key, arguments, call.inline).results)
        else:
            results = self.read(call.jaxpr, arguments)
        known.update(zip(flat(*call.results), flat(*results), strict=True))
        return kept

    def _equation(self, eqn: Any, arrays: list[Nodes]) -> list[Nodes]:
        entry, scalars = entry_of(eqn), None
        if any(map(is_key, (*eqn.invars, *eqn.outvars))) and eqn.primitive.name != "jit":
            return self.call(eqn, arrays)
        if entry is not None:
            try:
                if entry.any_type or not self._foreign(eqn):
                    scalars = entry.scalars(self, eqn, *arrays)
                else:
                    scalars = piecewise_constant(self, entry, eqn, arrays)
            except Unread as error:
                say_unread(error)
        return self.call(eqn, arrays) if scalars is None else scalars

    def _literal(self, literal: Any) -> Nodes:
        key = (literal.aval.dtype, np.shape(literal.val), np.asarray(literal.val).tobytes())
        if key not in self._literals:
            self._literals[key] = self.graph.array(np.asarray(literal.val, literal.aval.dtype))
        return self._literals[key]

    def _foreign(self, eqn: Any) -> bool:
        """Whether an equation works in complex numbers, or in a precision that is not the program's."""
        dtypes = (v.aval.dtype for v in (*eqn.invars, *eqn.outvars))
        return any(jnp.issubdtype(dtype, jnp.inexact) and dtype != self.graph.dtype for dtype in dtypes)


def repeats_in_kernels(program: ScalarProgram, graph: ScalarGraph) -> bool:
    """Whether kernels may compute a program that a graph contains several times in a function, side by side."""
    arrays = [*map(program.graph.dtype_of, program.inputs), *program.types]
    fits = program.graph.simplifies_as(graph) and all(dtype == graph.dtype == np.float64 for dtype in arrays)
    return fits and program.operations >= LEAST_REPEATED


def renamed(known: dict[int, int], array: Nodes) -> Nodes:
    """An array of nodes of the old graph, in the new one."""
    return nodes([known[i] for i in flat(array)], array.shape)


def scalarize(
    function: Callable[..., Any] | ClosedJaxpr,
    *shapes: Any,
    checked: bool = False,
    largest: int = 200_000,
    limits: Limits = LIMITS,
) -> ScalarProgram:
    """A function of arrays whose results are a list of arrays, as a scalar program.

    Args:
        function: traceable; or its jaxpr.
        shapes: of the arguments, with types; left out for a jaxpr.
        checked: keep 0 x, 0 / x and x - x, which differ from zero where x is not finite.
        largest: the most scalars there may be.
        limits: up to which size parts are unrolled.
    Raises:
        TooLarge: more scalars than are good for a compiler.
    """
    closed = function if isinstance(function, ClosedJaxpr) else jax.make_jaxpr(function)(*shapes)
    avals = [v.aval for v in closed.jaxpr.invars]
    types = (np.dtype(a.dtype) for a in [*avals, *(v.aval for v in closed.jaxpr.outvars)])
    precision = next((t for t in types if t.kind == "f"), np.dtype(jax.dtypes.canonicalize_dtype(float)))
    # Only atan2 distinguishes signed zeros.
    signed_zeros = any(eqn.primitive.name == "atan2" for eqn in all_equations(closed.jaxpr))
    graph = ScalarGraph(precision, checked, largest, limits, signed_zeros)
    inputs = tuple(
        nodes([graph.input(k, j, np.dtype(a.dtype)) for j in range(a.size)], a.shape) for k, a in enumerate(avals)
    )
    outputs = JaxprReader(graph).read(closed, inputs)
    return ScalarProgram(graph, inputs, tuple(outputs), tuple(np.dtype(v.aval.dtype) for v in closed.jaxpr.outvars))


# ---- rewritten programs: in the form of emitters, in another order, or with a part computed before -------------------


def emitted_form(program: ScalarProgram, limits: Limits = LIMITS) -> ScalarProgram:
    """The program that an emitter writes: calls that are functions of scalars are unrolled, and x / d, y / d, ...
    become products with one 1 / d, unless the program is checked.

    A shared reciprocal costs one more rounding, half a unit in the last place.
    Args:
        limits: what is unrolled; more for emitters that cannot call a library.
    """
    expanded = program
    for _ in range(2):  # calls that are unrolled contain such operations too
        operations = filter(None, map(expanded.graph.operation, expanded.live))
        stays = all(stays_call(call, limits) for call in expanded.calls)
        if not stays or any(operation.written for operation in operations):
            expanded = rebuilt(expanded, set(), keep_calls=False, limits=limits)
    if program.graph.checked:
        return expanded
    g = expanded.graph
    uses = Counter(g.arguments(i)[1] for i in expanded.live if g.operation(i) is _DIV and g.dtypes[i] == g.dtype)
    shared = {divisor for divisor, count in uses.items() if count > 1}
    return rebuilt(expanded, shared, keep_calls=False, limits=limits) if shared else expanded


def one_by_one(
    program: ScalarProgram, first: Iterable[int] = (), substitutes: Mapping[int, Nodes] | None = None
) -> ScalarProgram:
    """The program in the form for code writers: calls that are functions of scalars are unrolled, and x / d, y / d, ...
    become products with a shared 1 / d, unless the program is checked.

    In the original order derivatives along many tangents are interleaved. In this one fewer numbers are live at a time,
    and pieces of the program share fewer.

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
    """The program in another order: result by result, each with the additional nodes that it needs.

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
    """The program in a new graph.

    Quotients by such numbers become products with their inverses.

    Args:
        program: in native form.
    """
    divisors = _alone(program, argument)
    divided = (program.graph.arguments(i) for i in program.live if program.graph.operation(i) is _DIV)
    shared = {b for a, b in divided if b in divisors and a not in divisors}
    program = rebuilt(program, shared, True, program.graph.limits) if shared else program
    old, alone = program.graph, _alone(program, argument)
    rest = [i for i in program.live if i not in alone]
    read = {a for i in rest for a in old.sources(i)} | set(program.flat)
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
