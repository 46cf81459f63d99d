"""Every tableau satisfies all order conditions of its order, and of its embedded order, and not those of the next.

A condition for each rooted tree t: sum_i b_i Phi_i(t) = 1 / gamma(t), by `tx.testing`, which takes nothing from the
tableaus but their numbers.
"""

import pytest

from twistax.tableaus import ALL, DOP853, ButcherTableau
from twistax.testing import tableaus as laws


def test_the_trees_are_all_there() -> None:
    """Sloane's A000081."""
    assert [len(laws.trees(n)) for n in range(1, 10)] == [1, 1, 2, 4, 9, 20, 48, 115, 286]


@pytest.mark.parametrize("tableau", ALL, ids=lambda tableau: tableau.name)
def test_the_order_conditions(tableau: ButcherTableau) -> None:
    for _, b, a, order in laws.claims(tableau):
        assert max(laws.defect(a, b, n) for n in range(1, order + 1)) < 2e-14
        assert laws.defect(a, b, order + 1) > 1e-7


def test_a_wrong_digit_is_seen() -> None:
    a = DOP853.a.copy()
    a[7, 3] += 1e-9
    a[7, 4] -= 1e-9
    spoiled = ButcherTableau("spoiled", 8, a, DOP853.b, DOP853.c)
    assert max(laws.defect(spoiled.a, spoiled.b, n) for n in range(1, 9)) > 1e-12
