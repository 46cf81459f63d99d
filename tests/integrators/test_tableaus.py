"""Tableaus are data, checked when they are made."""

import numpy as np
import pytest

import twistax as tx
from twistax.tableaus import ALL, HEUN, RK4, ButcherTableau


def test_all_tableaus_are_distinct_and_sorted_by_order() -> None:
    assert len({tableau.name for tableau in ALL}) == len(ALL)
    assert [tableau.order for tableau in ALL] == sorted(tableau.order for tableau in ALL)
    assert tx.tableaus.ALL is ALL


@pytest.mark.parametrize("tableau", ALL, ids=lambda tableau: tableau.name)
def test_the_arrays_are_read_only(tableau: ButcherTableau) -> None:
    for array in (tableau.a, tableau.b, tableau.c):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0.0
    with pytest.raises(AttributeError):
        tableau.order = 7  # type: ignore[misc]


GOOD = {"name": "mine", "order": 2, "a": [[0, 0], [1, 0]], "b": [0.5, 0.5], "c": [0, 1]}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"b": [0.5, 0.4]}, "'mine': b must sum to 1, but it sums to 0.9"),
        ({"c": [0, 0.9]}, r"row 1 of a sums to 1, but c\[1\] is 0.9"),
        (
            {"a": [[0, 0], [0.5, 0.5]]},
            "row 1 of a must be zero on and right of the diagonal",
        ),
        ({"a": [[0, 0]]}, r"a must have shape \(2, 2\), got \(1, 2\)"),
        ({"c": [0]}, r"c must have shape \(2,\)"),
        ({"b": [[0.5, 0.5]]}, "b must be a vector"),
        ({"b": [np.nan, 1.0]}, "b has entries that are not finite"),
        ({"b": ["x", 1.0]}, "b expects real numbers"),
        ({"order": 0}, "order must be a positive whole number, got 0"),
        ({"embedded_order": 1}, "a pair needs both embedded_order and b_embedded"),
        ({"embedded_order": 1, "b_embedded": [1.0, 0.1]}, "b_embedded must sum to 1"),
        ({"embedded_order": 1, "b_embedded": [1.0]}, r"b_embedded must have shape \(2,\), got \(1,\)"),
        ({"embedded_order": 0, "b_embedded": [1.0, 0.0]}, "embedded_order must be a positive whole number, got 0"),
        ({"second_embedded_order": 1}, "a pair needs both second_embedded_order and b_second_embedded"),
        ({"second_embedded_order": 1, "b_second_embedded": [1.0, 0.0]}, "a second embedded solution needs a first one"),
    ],
)
def test_a_wrong_tableau_says_what_is_wrong(change: dict, message: str) -> None:
    with pytest.raises(tx.ModelError, match=message):
        ButcherTableau(**(GOOD | change))


def test_a_pair_and_methods_are_values() -> None:
    pair = ButcherTableau(**GOOD, embedded_order=1, b_embedded=[1.0, 0.0])
    assert pair.stages == 2
    assert pair.b_embedded is not None
    assert not pair.b_embedded.flags.writeable
    assert tx.RKMK(RK4) == tx.RKMK(RK4)
    assert hash(tx.RKMK(RK4)) == hash(tx.RKMK(RK4))
    assert tx.RKMK(RK4) != tx.RKMK(HEUN)


def test_the_power_of_the_estimated_error() -> None:
    """That of the embedded order plus one; DOP853 weighs two estimates against each other."""
    powers = {tableau.name: tableau.error_order for tableau in ALL if tableau.is_pair}
    assert powers == {
        "Bogacki-Shampine 3(2)": 3,
        "Dormand-Prince 5(4)": 5,
        "Tsitouras 5(4)": 5,
        "DOP853": 8,
        "Dormand-Prince 8(7)": 8,
    }
    with pytest.raises(tx.ModelError, match="'RK4': the method has no embedded solution"):
        _ = RK4.error_order
