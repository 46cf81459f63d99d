"""The Hessian of a weighted sum of a system's functions: from scalar programs, with its sparsity pattern, or else by
JAX.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from ..checks import listed
from ..errors import InputError, ModelError
from ..expr import Expr, Inputs
from ..groups import Group
from ..jax_inside import ClosedJaxpr, all_equations
from ..scalar.derivatives import columns_of, contracted_program, cotangent_program, needed, reached
from ..scalar.graph import TooLarge
from ..scalar.jax_primitive import call_program
from ..scalar.primitives.interface import Nodes, flat
from ..scalar.program import ScalarProgram
from ..scalar.reader import JaxprReader, one_by_one, scalarize
from .functions import Functions, Places
from .inputs import Values, read_values
from .jacobian import Differentiated, along, check_kinds, tangents_of

#: What comes of functions without a Hessian on the graph: too many scalars, or a call of JAX lacks one derivative.
REFUSALS = (TooLarge, TypeError, ValueError, NotImplementedError)

#: (program, which arguments) -> (arguments, weights of the results) -> the gradient of the weighted sum.
Gradient = Callable[[ScalarProgram, Sequence[int]], ScalarProgram]


def hessian(
    functions: Functions,
    t: Any,
    x: Values,
    u: Values | None,
    params: Values | None,
    weights: Values,
    wrt: tuple[str, ...],
) -> jax.Array:
    """Implements `Dynamics.hessian`."""
    if not isinstance(weights, Mapping):
        raise InputError(f"weights must be a dict from names to arrays, got {type(weights).__name__}")
    check_kinds(wrt)
    weighted = _weighted(functions, weights)
    inputs = functions.prepare(t, x, u, params, reads={function.family for function in weighted})
    values = read_values("weights", weighted, weights, inputs.dtype)
    multipliers = [values[function.name].reshape(-1) for function in weighted]
    places, arrays = functions.flat(inputs)
    matrix = _kept(functions, weighted, inputs, wrt)
    if matrix is None:
        plain = functools.partial(_in_arrays, functions, weighted, places, wrt)
        run = functions.hessians.get((*_key(weighted, places, inputs, wrt), "arrays"), lambda: jax.jit(plain))
        return run(arrays, multipliers)
    key = (functions.backend, matrix)
    derived = functions.hessians.get(key, lambda: functions.backend.derived(matrix.program))
    return call_program(derived, *arrays, *multipliers)[0]


def hessian_pattern(functions: Functions, weights: Iterable[str], wrt: tuple[str, ...]) -> NDArray[np.bool_]:
    """Implements `Dynamics.hessian_pattern`."""
    check_kinds(wrt)
    matrix = _kept(functions, _weighted(functions, weights), functions.zeros(), wrt)
    if matrix is None:
        raise ModelError(
            "the Hessian has no pattern, because it takes too many scalars, or derivatives that only JAX can compute"
        )
    return matrix.pattern.copy()


# ---- what is weighted ------------------------------------------------------------------------------------------------


class _Weighted(NamedTuple):
    """A rate, an output, a constraint, or all constraints of a kind; the shape is that of its weight."""

    name: str
    family: str
    exprs: tuple[Expr, ...]
    shape: tuple[int, ...]


def _weighted(functions: Functions, names: Iterable[str]) -> tuple[_Weighted, ...]:
    """The functions of these names, in the order of declaration. Raises InputError."""
    families = {name: functions.families[name] for name in ("rates", "outputs")}
    families["constraints"] = {n: [e] for members in functions.constraints.values() for n, e in members.items()}
    known = [
        _Weighted(name, family, (expr,), expr.shape)
        for family, members in families.items()
        for name, (expr,) in members.items()
    ]
    for kind, members in functions.constraints.items():
        size = sum(math.prod(e.shape) for e in members.values())
        known.append(_Weighted(kind, "constraints", tuple(members.values()), (size,)))
    chosen = []
    for name in dict.fromkeys([names] if isinstance(names, str) else names):
        same = [candidate for candidate in known if candidate.name == name]
        if not same:
            names = listed([candidate.name for candidate in known], name)
            raise InputError(f"unknown key {name!r} in weights; expected a rate, an output or a constraint: {names}")
        if len(same) > 1:
            raise InputError(
                f"weights[{name!r}] is ambiguous: the system has {' and '.join(c.family for c in same)} "
                "with that name.\n  fix: rename the output or the constraint"
            )
        if same[0].exprs and same[0].exprs[0].boolean:
            raise InputError(f"weights[{name!r}]: the output is a condition, not a number")
        chosen.append(same[0])
    return tuple(sorted(chosen, key=known.index))


def _values(functions: Functions, weighted: Sequence[_Weighted], places: Places, *arrays: jax.Array) -> list[jax.Array]:
    """The values of each function as a vector."""
    roots = {function.name: list(function.exprs) for function in weighted}
    return list(functions.values(roots, True, *functions.by_kind(places, arrays)).values())


def _kept(
    functions: Functions, weighted: tuple[_Weighted, ...], inputs: Inputs, wrt: tuple[str, ...]
) -> WeightedHessian | None:
    """The program for arguments of these types; None where it has none."""
    places, arrays = functions.flat(inputs)

    def make() -> WeightedHessian | None:
        closed = jax.make_jaxpr(functools.partial(_values, functions, weighted, places))(*arrays)
        try:
            return WeightedHessian(Differentiated(closed, places, functions.group, wrt))
        except REFUSALS:
            return None

    return functions.hessians.get(_key(weighted, places, inputs, wrt), make)


def _key(weighted: Sequence[_Weighted], places: Places, inputs: Inputs, wrt: tuple[str, ...]) -> tuple[Any, ...]:
    return (tuple(function.name for function in weighted), places, wrt, inputs.dtype)


# ---- in arrays -------------------------------------------------------------------------------------------------------


def hessian_in_arrays(total: Callable[[jax.Array], jax.Array], zero: jax.Array) -> jax.Array:
    """The second derivatives of a function of a vector, by JAX, made exactly symmetric."""
    try:
        second = jax.hessian(total)(zero)
    except (TypeError, ValueError):  # a loop of unknown length has derivatives forward alone
        second = jax.jacfwd(jax.jacfwd(total))(zero)
    # One number in both places: XLA may round an entry and its mirror image differently.
    n = len(zero)
    rows, columns = np.tril_indices(n)
    places = np.zeros((n, n), int)
    places[rows, columns] = places[columns, rows] = np.arange(len(rows))
    return second[rows, columns][places]


def _in_arrays(
    functions: Functions,
    weighted: Sequence[_Weighted],
    places: Places,
    wrt: tuple[str, ...],
    arrays: Sequence[jax.Array],
    weights: Sequence[jax.Array],
) -> jax.Array:
    """The Hessian by JAX: of the weighted sum as a function of all tangents."""
    sizes, moved = along(functions.group, places, wrt, arrays)

    def total(d: jax.Array) -> jax.Array:
        return sum(map(jnp.vdot, weights, _values(functions, weighted, places, *moved(d))), jnp.zeros((), d.dtype))

    return hessian_in_arrays(total, jnp.zeros(sum(sizes.values()), arrays[0].dtype))


# ---- on the graph ----------------------------------------------------------------------------------------------------


class WeightedHessian:
    """The second derivatives of sum_i w_i . f_i with respect to right perturbations x (+) d of states, and to other
    arguments.

    Forward derivatives of the gradient, which is computed in reverse or forward mode, whichever takes fewer operations.
    For each pair of tangents only one of the two orders is computed.

    Args:
        given: the functions f_i.
        weighted: the number of leading functions that have weights; all if None.

    Attributes:
        pattern: where the symmetric matrix is not structurally zero.

    Raises:
        TypeError, ValueError, NotImplementedError: a call lacks the required derivative.
        TooLarge: too many scalars.
    """

    def __init__(self, problem: Differentiated, weighted: int | None = None) -> None:
        sweeps: list[_Sweep] = []
        refusal: Exception | None = None
        for gradient in (cotangent_program, contracted_program):
            if sweeps and sweeps[0].forward > sweeps[0].gradient.operations:
                break
            try:
                sweeps.append(_Sweep(problem, weighted, gradient))
            except REFUSALS as error:
                refusal = error
        if not sweeps and refusal is not None:
            raise refusal
        self._best = best = min(sweeps, key=lambda sweep: sweep.operations)
        self._matrix, self._in_order = best.matrix()
        program = best.gradient.restricted([self._matrix])
        # JAX says only where it runs that a function has no forward derivative.
        if any(eqn.primitive.name == "custom_lin" for c in program.calls for eqn in all_equations(c.jaxpr.jaxpr)):
            raise TypeError("a called function has only a reverse-mode derivative")
        self.pattern = self._matrix != program.graph.zero
        self._program = program

    @functools.cached_property
    def program(self) -> ScalarProgram:
        """A function A function (arguments, weights w_i) -> the matrix."""
        # Rows with most entries last: measurements show the fewest memory stalls of kernels in this order.
        return one_by_one(self._program, self._in_order)

    def beside_values(self, substituted: Mapping[int, int]) -> ScalarProgram:
        """A function A function (arguments, weights w_i) -> the functions, the Jacobian of those with weights, and the
        matrix.

        Args:
            substituted: arguments that are functions themselves, by their indices; they are not arguments of the
                program.
        """
        best, g = self._best, self._best.gradient.graph
        slopes = np.full((len(best.weighted.flat), len(self._matrix)), g.zero)
        for (row, column), node in columns_of(best.weighted, best.seeds).items():
            slopes[row, column] = node
        results = [*best.program.outputs, slopes, self._matrix]
        nodes = {argument: best.program.outputs[k] for argument, k in substituted.items()}
        return one_by_one(best.gradient.restricted(results), self._in_order, nodes)


class _Sweep:
    """A planned forward sweep over one gradient.

    Attributes:
        program: the functions.
        weighted: those with weights.
        seeds: input node -> (tangent -> derivative of the entry along it).
        forward: about how many operations all first derivatives take.
        gradient: (arguments, weights) -> derivatives of the weighted sum by the entries of the arguments.
        operations: about how many the Hessian takes.
    """

    def __init__(self, problem: Differentiated, weighted: int | None, gradient: Gradient) -> None:
        self.program = program = scalarize(problem.closed)
        self.weighted = program.restricted(program.outputs[:weighted])
        self.seeds, widths = tangents_of(program, problem)
        self._size = sum(widths.values())
        self._bends = _bends(program, problem, widths) if "x" in problem.wrt else {}
        self.forward = sum(tangents.bit_count() for tangents in reached(self.weighted, self.seeds).values())
        active = [k for k, (kind, _) in enumerate(problem.places) if kind in problem.wrt]
        self.gradient = gradient(self.weighted, active)
        self._entries = flat(*(program.inputs[k] for k in active))
        touching = reached(self.gradient, self.seeds)
        touched = [sum(touching[i] >> k & 1 for i in self.gradient.live) for k in range(self._size)]
        order = sorted(range(self._size), key=lambda k: -touched[k])
        #: tangent -> those along which its part of the gradient is differentiated, each a bit of a number.
        self._partners = dict(zip(order, itertools.accumulate(1 << k for k in order)))
        wanted: dict[int, int] = {}
        for node, entry in zip(self.gradient.flat, self._entries, strict=True):
            for tangent in self.seeds[entry]:
                wanted[node] = wanted.get(node, 0) | self._partners[tangent]
        self._wanted = needed(self.gradient, wanted)
        carried = (touching[i] & self._wanted.get(i, 0) for i in self.gradient.live)
        self.operations = self.gradient.operations + sum(tangents.bit_count() for tangents in carried)

    def matrix(self) -> tuple[Nodes, list[int]]:
        """The nodes of the Hessian, d2 entry / dd dd' times the gradient by the entry, and that of the gradient.

        The same nodes once more in the order to compute them in.
        """
        g, slopes = self.gradient.graph, self.gradient.flat
        second_derivatives = columns_of(self.gradient, self.seeds, self._wanted)
        sums: dict[tuple[int, int], int] = {}
        for (place, column), second in sorted(second_derivatives.items()):
            for tangent, moved in self.seeds[self._entries[place]].items():
                if self._partners[tangent] >> column & 1:
                    pair = (tangent, column)
                    sums[pair] = g.add(sums.get(pair, g.zero), g.mul(moved, second))
        for place, entry in enumerate(self._entries):
            for (tangent, column), bend in self._bends.get(entry, {}).items():
                if self._partners[tangent] >> column & 1:
                    pair = (tangent, column)
                    sums[pair] = g.add(sums.get(pair, g.zero), g.mul(bend, slopes[place]))
        matrix = np.full((self._size, self._size), g.zero)
        for (tangent, column), node in sums.items():
            matrix[tangent, column] = matrix[column, tangent] = node
        rank = {tangent: at for at, tangent in enumerate(self._partners)}
        order = sorted(sums, key=lambda pair: (-rank[pair[0]], rank[pair[1]]))
        return matrix, [sums[pair] for pair in order]


def _bends(
    program: ScalarProgram, problem: Differentiated, widths: Mapping[str, int]
) -> Mapping[int, dict[tuple[int, int], int]]:
    """The second derivatives of the entries of x (+) d at d = 0: input node -> (pair of tangents -> node)."""
    g, group = program.graph, problem.group
    start = sum(widths[kind] for kind in problem.wrt[: problem.wrt.index("x")])
    bends_of: dict[int, dict[tuple[int, int], int]] = {}
    for array, (kind, name) in zip(program.inputs, problem.places, strict=True):
        if kind == "x" and not group.factors[name].flat:
            (bends,) = JaxprReader(g).read(_bend_of(group.factors[name], array.shape, g.dtype), [array])
            first = start + group.slices[name].start
            for entry, block in zip(flat(array), bends, strict=True):
                pairs = {(first + i, first + j): int(node) for (i, j), node in np.ndenumerate(block)}
                bends_of[entry] = {pair: node for pair, node in pairs.items() if node != g.zero}
    return bends_of


@functools.lru_cache(maxsize=64)
def _bend_of(factor: Group, shape: tuple[int, ...], dtype: np.dtype[Any]) -> ClosedJaxpr:
    def function(array: jax.Array) -> jax.Array:
        zero = jnp.zeros(factor.dimension, dtype)
        second = jax.jacfwd(jax.jacfwd(lambda d: factor.retract(array, d)))(zero)
        return second.reshape(-1, factor.dimension, factor.dimension)

    return jax.make_jaxpr(function)(jax.ShapeDtypeStruct(shape, dtype))
