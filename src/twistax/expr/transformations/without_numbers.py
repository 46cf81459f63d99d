"""Expressions without their numbers: expressions that differ only in numbers have one structure.

The entries of a constant become those of a hidden parameter. Numbers that determine the operations remain: zeros, unit
factors, exponents, tables, conditions, and static fields of nodes.
"""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from numpy import ndarray as Array

from ...scalar.walk import walk
from ..fields import freeze
from ..leaves import Constant, Leaf, Parameter
from ..node import Expr
from ..operations.arithmetic import Add, Power, Sub
from ..operations.choice import Max, Min
from ..operations.comparisons import Comparison
from ..tables.interpolation import Bilerp, Cinterp, Interp, Linterp
from .rate import Rate
from .vmap import Vmap

#: Sizes of numbers that may be inverted and multiplied with each other without leaving the range of numbers.
_LEAST, _MOST = 1e-100, 1e100
#: Nodes in which a one is a number as any other.
_SUMS = (Add, Sub, Comparison, Max, Min)
#: Nodes that read the numbers of their operands where they are built or evaluated.
_READERS = (Bilerp, Cinterp, Interp, Linterp, Rate)
_PACKAGE = __name__.partition(".")[0]

#: What a leaf counts as in a structure; None where it counts with all that it has.
Token = Callable[[Leaf], Hashable]


class Hidden(NamedTuple):
    """A constant that is represented by a parameter.

    Attributes:
        leaf: the parameter.
        first: the index of its first entry in the vector of all numbers.
        free: (entries,) which entries are taken from the vector.
        value: the value of the constant.
    """

    leaf: Parameter
    first: int
    free: Array
    value: Array

    def read(self, numbers: Any) -> Any:
        """Its value from the vector of all numbers."""
        entries = numbers[self.first : self.first + int(self.free.sum())]
        if self.free.all():
            return entries.reshape(self.value.shape)
        places = np.where(self.free, np.cumsum(self.free) - 1, len(entries) + np.arange(self.free.size))
        return jnp.concatenate([entries, jnp.asarray(self.value.ravel(), entries.dtype)])[places].reshape(
            self.value.shape
        )


class Structure:
    """A key of expressions that does not contain their free numbers, and these numbers.

    Args:
        roots: canonical expressions.
        token: the token that represents a leaf in the key.

    Attributes:
        key: equal for expressions that differ only in numbers.
        numbers: (n,) the numbers of these expressions.
    """

    def __init__(self, roots: Sequence[Expr], token: Token) -> None:
        self._roots, self._token = roots, token
        self._hidden: dict[tuple[str, int], Hidden] = {}
        self._count = 0
        digest, classes = hashlib.blake2b(digest_size=20), dict[Any, int]()
        places: dict[str, int] = {}
        for node in walk(roots, _operands, Expr.key):
            if isinstance(node, Constant):
                continue
            kind = classes.setdefault((type(node), type(node).evaluate), len(classes))
            below = [self._place(node, k, operand, places) for k, operand in enumerate(_operands(node))]
            digest.update(repr((kind, self._static(node), below)).encode())
            places[node.key()] = len(places)
        ends = [self._place(None, k, root, places) for k, root in enumerate(roots)]
        digest.update(repr(ends).encode())
        self.key: Hashable = (digest.hexdigest(), *classes)
        parts = [operand.value.ravel()[operand.free] for operand in self._hidden.values()]
        self.numbers = np.concatenate([*parts, np.zeros(0)], dtype=float)

    @functools.cached_property
    def roots(self) -> list[Expr]:
        """The expressions with parameters in place of their numbers."""
        done: dict[str, Expr] = {}
        for node in walk(self._roots, _operands, Expr.key):
            operands = _operands(node)
            new = [self._exchanged(node, k, operand, done) for k, operand in enumerate(operands)]
            same = all(a is b for a, b in zip(new, operands, strict=True))
            done[node.key()] = node if same else _rebuilt(node, new)
        return [self._exchanged(None, k, root, done) for k, root in enumerate(self._roots)]

    def params(self, numbers: Any) -> dict[str, Any]:
        """The values of those parameters by name, from the vector of all numbers."""
        return {hidden.leaf.name: hidden.read(numbers) for hidden in self._hidden.values()}

    def _place(self, parent: Expr | None, k: int, child: Expr, places: Mapping[str, int]) -> Any:
        """What stands for an operand in the structure."""
        if not isinstance(child, Constant):
            return places[child.key()]
        free = _free(parent, k, child)
        if not free.any():
            return ("constant", child.static_key())
        name = f"\0number {len(self._hidden)}"
        self._hidden[_owner(parent), k] = Hidden(Parameter(name, child.shape), self._count, free, child.value)
        self._count += int(free.sum())
        return ("numbers", child.shape, free.tobytes(), freeze(child.value.ravel()[~free]))

    def _exchanged(self, parent: Expr | None, k: int, child: Expr, done: Mapping[str, Expr]) -> Expr:
        hidden = self._hidden.get((_owner(parent), k))
        return done[child.key()] if hidden is None else hidden.leaf

    def _static(self, node: Expr) -> Any:
        if isinstance(node, Leaf):
            token = self._token(node)
            return (node.static_key() if token is None else token,)
        if isinstance(node, Vmap):
            return (node.axis, [leaf.static_key() for leaf in node.placeholders])
        return node.static_key()


def _owner(parent: Expr | None) -> str:
    return "" if parent is None else parent.key()


def _operands(node: Expr) -> list[Expr]:
    return [*node.batches, node.body] if isinstance(node, Vmap) else node.children()


def _rebuilt(node: Expr, operands: list[Expr]) -> Expr:
    return node.over(operands[:-1], operands[-1]) if isinstance(node, Vmap) else node.with_children(operands)


def _free(parent: Expr | None, k: int, constant: Constant) -> Array:
    """(entries,) which entries of a constant are numbers, as an operand of a node or as a root."""
    values = constant.value.ravel()
    known = parent is None or type(parent).__module__.partition(".")[0] == _PACKAGE
    reads = isinstance(parent, _READERS) or (isinstance(parent, Power) and k == 1)
    if constant.boolean or not known or reads:
        return np.zeros(values.shape, bool)
    sizes = np.abs(values)
    one = (sizes == 1.0) & (parent is not None and not isinstance(parent, _SUMS))
    is_number: Array = (sizes >= _LEAST) & (sizes <= _MOST) & ~one
    return is_number
