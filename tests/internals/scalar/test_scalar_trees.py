"""Random expressions as scalars: value and derivatives as the plain lowering has them."""

from __future__ import annotations

from random import Random
from typing import Any

import jax
import numpy as np
import pytest
from expr_cases import function_of
from scalar_cases import Case, compare, oracles
from test_random_trees import LEAVES, SHAPES, Forest, by_numpy

from twistax import expr as tx
from twistax.scalar.reader import emitted_form

NAMES = [leaf.name for leaves in LEAVES.values() for leaf in leaves]


def tree(seed: int, depth: int, least: int, most: int) -> Case:
    """A tree of that many nodes, at values where its numbers stay moderate."""
    forest = Forest(Random(seed))
    while True:
        expr, values = forest.tree(forest.source.choice(SHAPES), depth), forest.values()
        if not least <= len(list(tx.postorder(expr))) <= most:
            continue
        with np.errstate(all="ignore"):
            if by_numpy(expr, values)[1] < 1e4:
                break

    def function(*arrays: jax.Array) -> Any:
        return function_of(expr)(dict(zip(NAMES, arrays, strict=True)))

    return Case(f"{seed}: {expr!r}"[:60], function, tuple(values[name] for name in NAMES), atol=1e-10)


CASES = [tree(seed, depth, 5, 500) for depth, seeds in ((2, 7), (3, 6), (4, 5)) for seed in range(seeds)]


def test_random_trees() -> None:
    expected = oracles(CASES)
    for case in CASES:
        compare(case, expected[case.name])


def test_the_trees_are_of_all_sizes() -> None:
    sizes = [emitted_form(case.program).operations for case in CASES]  # solves unrolled
    assert min(sizes) < 10
    assert max(sizes) > 200


@pytest.mark.slow
@pytest.mark.parametrize("part", range(50))
def test_many_random_trees(part: int) -> None:
    cases = [tree(1000 + 20 * part + k, 2 + k % 4, 5, 500) for k in range(20)]
    expected = oracles(cases)
    for case in cases:
        compare(case, expected[case.name])
