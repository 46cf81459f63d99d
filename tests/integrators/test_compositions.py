"""Compositions: their order conditions in the algebra of all words, and what their constructor refuses."""

from typing import Any

import mpmath as mp
import numpy as np
import pytest

import twistax as tx

Words = dict[tuple[int, ...], Any]


def product(a: Words, b: Words, top: int) -> Words:
    """The product of two sums of words, without words of a degree above `top`."""
    found: Words = {}
    for u, x in a.items():
        for v, y in b.items():
            if sum(u) + sum(v) <= top:
                found[u + v] = found.get(u + v, 0) + x * y
    return found


def exponential(a: Words, top: int) -> Words:
    total: Words = {(): mp.mpf(1)}
    term = total
    for k in range(1, top + 1):
        term = {word: x / k for word, x in product(term, a, top).items()}
        total = {word: total.get(word, 0) + term.get(word, 0) for word in total | term}
    return total


def defect(composition: tx.compositions.Composition, degree: int) -> float:
    """The largest coefficient of this degree in exp(A_1) - prod_k exp(w_k A_1 + w_k^3 A_3 + w_k^5 A_5 + ...).

    A symmetric method of order 2 is exp(h A_1 + h^3 A_3 + ...) with letters A_i that do not commute.
    """
    whole: Words = {(): mp.mpf(1)}
    for weight in map(mp.mpf, composition.weights.tolist()):
        letters = {(k,): weight**k for k in range(1, degree + 1, 2)}
        whole = product(whole, exponential(letters, degree), degree)
    wanted = exponential({(1,): mp.mpf(1)}, degree)
    return max(float(abs(x - wanted.get(word, 0))) for word, x in whole.items() if sum(word) == degree)


@pytest.mark.parametrize("composition", tx.compositions.ALL, ids=lambda c: c.name)
def test_order_conditions_hold_to_round_off_and_no_further(composition: tx.compositions.Composition) -> None:
    with mp.workdps(30):
        for degree in range(1, composition.order + 1):
            assert defect(composition, degree) < 4e-16
        assert defect(composition, composition.order + 1) > 1e-6


def test_a_weight_that_is_off_by_one_part_in_1e12_is_seen() -> None:
    weights = tx.compositions.KAHAN_LI8.weights.copy()
    weights[[1, 15]] += 1e-13
    weights[8] -= 2e-13
    off = object.__new__(tx.compositions.Composition)
    object.__setattr__(off, "weights", weights)
    with mp.workdps(30):
        assert max(defect(off, degree) for degree in range(1, 9)) > 1e-14


def test_kicks_of_all_but_negative_steps_lie_inside_of_the_step() -> None:
    for composition in tx.compositions.ALL:
        assert composition.nodes.min() > 0.0
        assert composition.nodes.max() < 1.0
        assert np.isclose(composition.between.sum(), 1.0, rtol=1e-14)
        assert composition.between.size == composition.stages + 1


def test_weights_are_read_only() -> None:
    with pytest.raises(ValueError, match="read-only"):
        tx.compositions.STRANG.weights[0] = 2.0


@pytest.mark.parametrize(
    ("order", "weights", "message"),
    [
        (3, [1.0], "order must be an even whole number, got 3"),
        (2, [0.4, 0.6], "read the same backwards"),
        (2, [0.4, 0.4], "weights must sum to 1 for order 2, but they sum to 0.8"),
        (4, [0.3, 0.4, 0.3], "powers 3 of the weights must sum to 0 for order 4"),
        (2, [], "shape"),
        (2, [np.nan], "finite"),
        (2, "abc", "weights expects real numbers"),
    ],
)
def test_refuses(order: int, weights: Any, message: str) -> None:
    with pytest.raises(tx.ModelError, match=f"composition 'mine': .*{message}"):
        tx.compositions.Composition("mine", order, weights)
