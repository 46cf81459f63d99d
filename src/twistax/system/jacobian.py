"""The Jacobian of the rates from scalar programs, with its sparsity pattern."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..groups import Product
from ..jax_inside import ClosedJaxpr
from ..scalar.derivatives import columns_of
from ..scalar.graph import LIMITS, ScalarGraph, TooLarge
from ..scalar.primitives.interface import Nodes, flat
from ..scalar.program import ScalarProgram
from ..scalar.reader import JaxprReader, one_by_one, scalarize

#: Of derivatives that are known, products of matrices are loops.
_LIMITS = dataclasses.replace(LIMITS, products=1000)
#: The most scalars in a program of derivatives.
LARGEST = 200_000
#: Of larger rates the derivatives that are known were always the shorter ones: the others are not tried.
_SMALL = 1000


#: What arguments are: ("t", "t"), then "x", "u" or "params" with a name.
Places: TypeAlias = Sequence[tuple[str, str]]


def check_kinds(wrt: tuple[str, ...]) -> None:
    """Raise InputError unless all entries are "x", "u" or "params", each at most once."""
    for kind in wrt:
        if kind not in ("x", "u", "params"):
            raise InputError(f"wrt expects names out of 'x', 'u' and 'params', got {kind!r}")
    if len(set(wrt)) < len(wrt):
        raise InputError(f"wrt expects each of 'x', 'u' and 'params' once, got {wrt}")


class Differentiated(NamedTuple):
    """Functions of flat arguments, and the arguments with respect to which they are differentiated."""

    closed: ClosedJaxpr  # each result a flat vector
    places: Places
    group: Product  # of the states, in the order of declaration
    wrt: Sequence[str]  # the kinds of arguments


#: Input node -> (tangent -> its entry there), zeros left out.
Seeds: TypeAlias = dict[int, dict[int, int]]

#: Derivatives that are known, by state: what each is by, a state by name or a vector of so many entries.
Known: TypeAlias = Mapping[str, Sequence[str | int]]


class RateJacobian:
    """The derivatives of rates with respect to states, controls and parameters, as a scalar program; the rates are one
    flat vector.

    Args:
        given: the rates. If some derivatives are declared, their arguments and the derivatives follow the rates, in the
            order of `known`: first all vectors, then all matrices.
        largest: the largest number of scalars.
    Raises:
        TooLarge: the program has more scalars.
    """

    def __init__(self, problem: Differentiated, known: Known | None = None, largest: int = LARGEST) -> None:
        program = scalarize(problem.closed, largest=largest, limits=_LIMITS if known else LIMITS)
        rates, *vectors_of_slopes = program.outputs
        #: The rates alone.
        self.rates = program.restricted([rates])
        g = program.graph
        seeds, widths = tangents_of(program, problem)
        ends = dict(zip(widths, np.cumsum(list(widths.values())).tolist(), strict=True))
        dense = np.full((rates.size, sum(widths.values())), g.zero)
        learnt = np.zeros(rates.size, bool)
        for name in known or {}:
            learnt[problem.group.slices[name]] = True
        fixed = range(ends["params"] - widths["params"], ends["params"]) if "params" in widths else range(0)
        self._differentiate(dense, ~learnt, seeds)
        self._differentiate(dense, learnt, _along(seeds, lambda column: column in fixed))
        if known:
            moving = _along(seeds, lambda column: column not in fixed)
            states = ends["x"] - widths["x"] if "x" in widths else None
            vectors = iter(vectors_of_slopes)
            arguments = [(name, by) for name, slopes in known.items() for by in slopes]
            pairs = [(name, next(vectors) if isinstance(by, int) else by) for name, by in arguments]
            for (name, by), matrix in zip(pairs, vectors, strict=True):
                rows = dense[problem.group.slices[name]]
                if not isinstance(by, str):
                    _add(g, rows, _product(g, matrix, columns_of(program.restricted([by]), moving), rows.shape[1]))
                elif states is not None:
                    at = problem.group.slices[by]
                    _add(g, rows[:, states + at.start : states + at.stop], matrix)
        blocks = {kind: dense[:, ends[kind] - width : ends[kind]] for kind, width in widths.items()}
        self.program = one_by_one(program.restricted(list(blocks.values())))
        self.blocks: dict[str, Nodes] = dict(zip(blocks, self.program.outputs, strict=True))
        self.pattern = {kind: block != g.zero for kind, block in blocks.items()}
        self.rates = one_by_one(self.rates)  # without the graph of all derivatives, which would stay in memory

    def _differentiate(self, dense: Nodes, rows: NDArray[np.bool_], seeds: Seeds) -> None:
        """The derivatives of some of the rates, on the graph."""
        places = np.flatnonzero(rows)
        if len(places) and seeds:
            part = self.rates.restricted([self.rates.outputs[0][places]])
            for (row, column), node in columns_of(part, seeds).items():
                dense[places[row], column] = node


def fewer(plain: Callable[[], Differentiated], with_known: RateJacobian) -> RateJacobian:
    """The cheaper of automatic and declared derivatives, by the number of operations.

    Args:
        plain: returns only the rates, for which automatic derivatives are tried.
    """
    if with_known.rates.operations > _SMALL:
        return with_known
    try:
        largest = 2 * len(with_known.program.graph.nodes) + len(with_known.rates.graph.nodes)
        other = RateJacobian(plain(), largest=largest)
    except TooLarge:
        return with_known
    return other if other.program.operations < with_known.program.operations else with_known


def along(
    group: Product, places: Places, wrt: Sequence[str], arrays: Sequence[jax.Array]
) -> tuple[dict[str, int], Callable[[jax.Array], list[jax.Array]]]:
    """The number of tangents for each kind of argument; and a function that moves arguments along a tangent vector."""
    numbers_of = {kind: [k for k, (of, _) in enumerate(places) if of == kind] for kind in wrt}
    sizes = {kind: sum(arrays[k].size for k in numbers) for kind, numbers in numbers_of.items()}
    if "x" in numbers_of:
        sizes["x"] = group.dimension

    def moved(d: jax.Array) -> list[jax.Array]:
        result, at = list(arrays), 0
        for kind, numbers in numbers_of.items():
            if kind == "x":
                x = group.retract({places[k][1]: arrays[k] for k in numbers}, d[at : at + group.dimension])
                for k in numbers:
                    result[k] = x[places[k][1]]
                at += group.dimension
                continue
            for k in numbers:
                result[k] = arrays[k] + d[at : at + arrays[k].size].reshape(arrays[k].shape)
                at += arrays[k].size
        return result

    return sizes, moved


def blocks_in_arrays(
    rates: Callable[..., jax.Array], group: Product, places: Places, wrt: Sequence[str], arrays: Sequence[jax.Array]
) -> dict[str, jax.Array]:
    """The blocks of a Jacobian, by JAX: the derivatives along all tangents as one batch.

    Args:
        rates: a function of the arrays that returns one vector.
    """
    sizes, moved = along(group, places, wrt, arrays)
    slopes = jax.jacfwd(lambda d: rates(*moved(d)))(jnp.zeros(sum(sizes.values()), arrays[0].dtype))
    ends = list(itertools.accumulate(sizes.values()))
    return dict(zip(sizes, jnp.split(slopes, ends[:-1], axis=1), strict=True))


def _along(seeds: Seeds, wanted: Callable[[int], bool]) -> Seeds:
    """Some of the tangents alone."""
    chosen = {i: {column: node for column, node in row.items() if wanted(column)} for i, row in seeds.items()}
    return {i: row for i, row in chosen.items() if row}


def _add(g: ScalarGraph, onto: Nodes, more: Nodes) -> None:
    for place in np.ndindex(*onto.shape):
        onto[place] = g.add(int(onto[place]), int(more[place]))


def _product(g: ScalarGraph, matrix: Nodes, columns: Mapping[tuple[int, int], int], width: int) -> Nodes:
    """A matrix times another one, given by its entries that are not zero."""
    product = np.full((len(matrix), width), g.zero)
    for (k, j), node in columns.items():
        for i, entry in enumerate(matrix[:, k].tolist()):
            product[i, j] = g.add(int(product[i, j]), g.mul(entry, node))
    return product


def tangents_of(program: ScalarProgram, problem: Differentiated) -> tuple[Seeds, dict[str, int]]:
    """The derivatives of a program's arguments with respect to tangents: input node -> (tangent -> derivative); and the
    number of tangents for each kind.
    """
    g = program.graph
    widths: dict[str, int] = {}
    seeds: Seeds = {}
    offset = 0
    for kind in problem.wrt:
        arrays = {name: program.inputs[k] for k, (of, name) in enumerate(problem.places) if of == kind}
        entries = flat(*arrays.values())
        if kind == "x":
            moved = _moved(program, arrays, problem.group)
        else:
            moved = np.where(np.eye(len(entries)) > 0, g.one, g.zero)
        for entry, row in zip(entries, moved.tolist(), strict=True):
            seeds[entry] = {offset + j: value for j, value in enumerate(row) if value != g.zero}
        widths[kind] = moved.shape[1]
        offset += moved.shape[1]
    return seeds, widths


def _moved(program: ScalarProgram, values: dict[str, Nodes], group: Product) -> Nodes:
    """d (x (+) d) / dd at d = 0, entries of x by tangents, as nodes."""
    g = program.graph

    def function(*arrays: jax.Array) -> list[jax.Array]:
        x = dict(zip(values, arrays, strict=True))
        slopes = jax.jacfwd(lambda d: group.retract(x, d))(jnp.zeros(group.dimension, g.dtype))
        return [slopes[name].reshape(-1, group.dimension) for name in values]

    shapes = [jax.ShapeDtypeStruct(nodes.shape, g.dtype) for nodes in values.values()]
    return np.concatenate(JaxprReader(g).read(jax.make_jaxpr(function)(*shapes), list(values.values())))
