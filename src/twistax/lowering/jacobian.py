"""The Jacobian of the rates on the graph of scalars, with its pattern."""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from ..groups import Product
from ..jax_inside import ClosedJaxpr
from .scalar.derivatives import columns_of
from .scalar.entry import Nodes
from .scalar.program import Reader, ScalarProgram, one_by_one, scalarize

__all__ = ["RateJacobian"]


class RateJacobian:
    """d rates / d (states, controls, parameters) as a scalar program.

    Args:
        closed: the jaxpr of the rates, one flat vector, of flat arguments.
        places: what each argument is: ("t", "t"), or "x", "u" or "params" with a name.
        group: of the states, in the order of declaration.
        wrt: which of "x", "u", "params" to take derivatives by.
    """

    def __init__(
        self, closed: ClosedJaxpr, places: Sequence[tuple[str, str]], group: Product, wrt: Sequence[str]
    ) -> None:
        #: The rates alone.
        self.rates = program = scalarize(closed)
        g = program.graph
        widths: dict[str, int] = {}
        seeds: dict[int, dict[int, int]] = {}
        offset = 0
        for kind in wrt:
            arguments = [k for k, (own, _) in enumerate(places) if own == kind]
            if kind == "x":
                values = {places[k][1]: program.inputs[k] for k in arguments}
                moved = _moved(program, values, group)
                width = group.dimension
                for name, nodes in values.items():
                    rows = moved[name].reshape(nodes.size, width).tolist()
                    for entry, columns in zip(nodes.reshape(-1).tolist(), rows, strict=True):
                        seeds[entry] = {offset + j: value for j, value in enumerate(columns) if value != g.zero}
            else:
                width = sum(program.inputs[k].size for k in arguments)
                flat = [i for k in arguments for i in program.inputs[k].reshape(-1).tolist()]
                seeds.update({node: {offset + j: g.one} for j, node in enumerate(flat)})
            widths[kind] = width
            offset += width
        found = columns_of(program, seeds)
        dense = np.full((len(program.flat), offset), g.zero)
        for (row, column), node in found.items():
            dense[row, column] = node
        ends = np.cumsum(list(widths.values()))
        blocks = [dense[:, end - width : end] for width, end in zip(widths.values(), ends, strict=True)]
        self.program = one_by_one(program.restricted(blocks))
        self.blocks: dict[str, Nodes] = dict(zip(widths, self.program.outputs, strict=True))
        self.pattern = {kind: block != g.zero for kind, block in zip(widths, blocks, strict=True)}


def _moved(program: ScalarProgram, values: dict[str, Nodes], group: Product) -> dict[str, Nodes]:
    """d (x (+) d) / dd at d = 0, entries of x by tangents, as nodes."""
    g = program.graph

    def function(*arrays: jax.Array) -> list[jax.Array]:
        x = dict(zip(values, arrays, strict=True))
        zero = jnp.zeros(group.dimension, g.dtype)
        found = jax.jacfwd(lambda d: group.retract(x, d))(zero)
        return [found[name] for name in values]

    shapes = [jax.ShapeDtypeStruct(nodes.shape, g.dtype) for nodes in values.values()]
    return dict(zip(values, Reader(g).read(jax.make_jaxpr(function)(*shapes), list(values.values())), strict=True))
