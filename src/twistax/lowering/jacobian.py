"""The Jacobian of the rates on the graph of scalars, with its pattern."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..groups import Product
from ..jax_inside import ClosedJaxpr
from .scalar.derivatives import columns_of
from .scalar.entry import Nodes, flat
from .scalar.program import Reader, ScalarProgram, one_by_one, scalarize


class Differentiated(NamedTuple):
    """Functions of flat arguments, and what their derivatives are by."""

    closed: ClosedJaxpr  # each result a flat vector
    places: Sequence[tuple[str, str]]  # what each argument is: ("t", "t"), or "x", "u" or "params" with a name
    group: Product  # of the states, in the order of declaration
    wrt: Sequence[str]  # the kinds of arguments


class RateJacobian:
    """d rates / d (states, controls, parameters) as a scalar program; the rates are one flat vector."""

    def __init__(self, given: Differentiated) -> None:
        #: The rates alone.
        self.rates = program = scalarize(given.closed)
        g = program.graph
        seeds, widths = tangents_of(program, given)
        found = columns_of(program, seeds)
        dense = np.full((len(program.flat), sum(widths.values())), g.zero)
        for (row, column), node in found.items():
            dense[row, column] = node
        ends = np.cumsum(list(widths.values()))
        blocks = [dense[:, end - width : end] for width, end in zip(widths.values(), ends, strict=True)]
        self.program = one_by_one(program.restricted(blocks))
        self.blocks: dict[str, Nodes] = dict(zip(widths, self.program.outputs, strict=True))
        self.pattern = {kind: block != g.zero for kind, block in zip(widths, blocks, strict=True)}


def tangents_of(program: ScalarProgram, given: Differentiated) -> tuple[dict[int, dict[int, int]], dict[str, int]]:
    """How the arguments of a program move: input node -> (tangent -> derivative); and how many tangents a kind has."""
    g = program.graph
    widths: dict[str, int] = {}
    seeds: dict[int, dict[int, int]] = {}
    offset = 0
    for kind in given.wrt:
        own = {name: program.inputs[k] for k, (of, name) in enumerate(given.places) if of == kind}
        entries = flat(*own.values())
        moved = _moved(program, own, given.group) if kind == "x" else np.where(np.eye(len(entries)) > 0, g.one, g.zero)
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
        found = jax.jacfwd(lambda d: group.retract(x, d))(jnp.zeros(group.dimension, g.dtype))
        return [found[name].reshape(-1, group.dimension) for name in values]

    shapes = [jax.ShapeDtypeStruct(nodes.shape, g.dtype) for nodes in values.values()]
    return np.concatenate(Reader(g).read(jax.make_jaxpr(function)(*shapes), list(values.values())))
