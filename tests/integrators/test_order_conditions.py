"""Every tableau satisfies all order conditions of its order, and of its embedded order, and not those of the next.

A condition for each rooted tree t: sum_i b_i Phi_i(t) = 1 / gamma(t). Trees are generated here; nothing is taken from
the tableaus but their numbers. Source: Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I (1993),
section II.2.
"""

from __future__ import annotations

import functools

import numpy as np
import pytest

from twistax.tableaus import ALL, DOP853, ButcherTableau

#: A rooted tree is the sorted tuple of the trees that hang from its root.
Tree = tuple


@functools.cache
def trees(size: int) -> tuple[Tree, ...]:
    """All rooted trees with `size` nodes."""
    return tuple(sorted({tuple(sorted(forest)) for forest in forests(size - 1, size - 1)}, key=repr))


def forests(size: int, largest: int) -> list[tuple[Tree, ...]]:
    """Collections of trees with `size` nodes in all, none larger than `largest`."""
    if size == 0:
        return [()]
    return [
        (tree, *rest)
        for first in range(1, min(size, largest) + 1)
        for tree in trees(first)
        for rest in forests(size - first, first)
    ]


def nodes(tree: Tree) -> int:
    return 1 + sum(nodes(branch) for branch in tree)


def density(tree: Tree) -> int:
    """gamma: the product over all nodes of the size of the subtree above it."""
    return nodes(tree) * int(np.prod([density(branch) for branch in tree], dtype=np.int64))


def weight(tree: Tree, a: np.ndarray) -> np.ndarray:
    """Phi, by stage."""
    return functools.reduce(np.multiply, [a @ weight(branch, a) for branch in tree], np.ones(len(a)))


def defect(tableau: ButcherTableau, b: np.ndarray, order: int) -> float:
    """The largest violation of the conditions of exactly this order."""
    return max(abs(b @ weight(tree, tableau.a) - 1.0 / density(tree)) for tree in trees(order))


def test_the_trees_are_all_there() -> None:
    """Sloane's A000081."""
    assert [len(trees(n)) for n in range(1, 10)] == [1, 1, 2, 4, 9, 20, 48, 115, 286]


@pytest.mark.parametrize("tableau", ALL, ids=lambda tableau: tableau.name)
def test_the_order_conditions(tableau: ButcherTableau) -> None:
    claims = [(tableau.b, tableau.order)]
    if tableau.is_pair:
        claims.append((tableau.b_embedded, tableau.embedded_order))
    if tableau.b_second_embedded is not None:
        claims.append((tableau.b_second_embedded, tableau.second_embedded_order))
    for b, order in claims:
        assert max(defect(tableau, b, n) for n in range(1, order + 1)) < 2e-14
        assert defect(tableau, b, order + 1) > 1e-7


def test_a_wrong_digit_is_seen() -> None:
    a = DOP853.a.copy()
    a[7, 3] += 1e-9
    a[7, 4] -= 1e-9
    spoiled = ButcherTableau("spoiled", 8, a, DOP853.b, DOP853.c)
    assert max(defect(spoiled, spoiled.b, n) for n in range(1, 9)) > 1e-12
