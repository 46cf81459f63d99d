"""Implicit tableaus against collocation in fifty digits, what follows from them, and the small inverses."""

import dataclasses
from typing import Any

import mpmath
import numpy as np
import pytest

import twistax as tx
from twistax.tableaus import GAUSS_LEGENDRE4, IMPLICIT, RADAU_IIA3, RADAU_IIA5, RADAU_IIA9, CollocationTableau

BY_NAME = pytest.mark.parametrize("tableau", IMPLICIT, ids=lambda tableau: tableau.name)


def nodes(tableau: CollocationTableau) -> list[mpmath.mpf]:
    """The zeros of the polynomial that defines the method: of Legendre's, or of Radau's with the node 1."""
    s = tableau.stages

    def defining(x: mpmath.mpf) -> mpmath.mpf:
        gauss = mpmath.legendre(s, 2 * x - 1)
        return gauss - mpmath.legendre(s - 1, 2 * x - 1) if tableau.stiffly_accurate else gauss

    return [mpmath.findroot(defining, mpmath.mpf(float(c))) for c in tableau.c]


def integral(cs: list[mpmath.mpf], j: int, end: mpmath.mpf) -> mpmath.mpf:
    """Lagrange's polynomial of node j, integrated from zero."""

    def basis(x: mpmath.mpf) -> mpmath.mpf:
        return mpmath.fprod((x - c) / (cs[j] - c) for k, c in enumerate(cs) if k != j)

    return mpmath.quad(basis, [0, end])


@BY_NAME
def test_coefficients_are_those_of_collocation(tableau: CollocationTableau) -> None:
    with mpmath.workdps(50):
        cs = nodes(tableau)
        a = [[float(integral(cs, j, c)) for j in range(len(cs))] for c in cs]
        b = [float(integral(cs, j, mpmath.mpf(1))) for j in range(len(cs))]
    np.testing.assert_allclose(tableau.c, [float(c) for c in cs], atol=1e-15)
    np.testing.assert_allclose(tableau.a, a, atol=1e-15)
    np.testing.assert_allclose(tableau.b, b, atol=1e-15)


@BY_NAME
def test_the_order_is_the_highest_that_the_weights_reach(tableau: CollocationTableau) -> None:
    with pytest.raises(tx.ModelError, match="which order"):
        dataclasses.replace(tableau, order=tableau.order + 1)


@BY_NAME
def test_the_transformation_has_one_block_for_each_eigenvalue(tableau: CollocationTableau) -> None:
    with mpmath.workdps(40):
        inverse_of_a = mpmath.inverse(mpmath.matrix(tableau.a.tolist()))
        product = mpmath.matrix(tableau.untransform.tolist()) * inverse_of_a * mpmath.matrix(tableau.transform.tolist())
        eigenvalues = mpmath.eig(inverse_of_a, left=False, right=False)
    blocks = np.array(product.tolist(), float)
    expected = np.zeros_like(blocks)
    for i, mu in enumerate(tableau.real):
        expected[i, i] = mu
    for i, mu in enumerate(tableau.pairs):
        k = len(tableau.real) + 2 * i
        expected[k : k + 2, k : k + 2] = [[mu.real, mu.imag], [-mu.imag, mu.real]]
    # LAPACK rounds the eigenvectors, which ones by processor: at most in the last places of the terms of the product.
    terms = abs(tableau.untransform) @ abs(np.array(inverse_of_a.tolist(), float)) @ abs(tableau.transform)
    assert np.all(abs(blocks - expected) <= 16 * np.finfo(float).eps * terms)
    values = np.sort_complex(np.array([complex(value) for value in eigenvalues]))
    pairs = [value for mu in tableau.pairs for value in (mu, mu.conjugate())]
    np.testing.assert_allclose(np.sort_complex(np.array([*tableau.real, *pairs], complex)), values, atol=1e-13)


@BY_NAME
def test_the_end_is_a_sum_of_the_stages(tableau: CollocationTableau) -> None:
    slopes = np.random.default_rng(0).normal(size=tableau.stages)
    assert tableau.end @ (tableau.a @ slopes) == pytest.approx(tableau.b @ slopes, abs=1e-14)


@pytest.mark.parametrize("tableau", [RADAU_IIA3, RADAU_IIA5, RADAU_IIA9], ids=lambda tableau: tableau.name)
def test_the_estimate_vanishes_for_polynomials_up_to_its_order(tableau: CollocationTableau) -> None:
    def estimate(power: int) -> float:
        """For y' = (p) t^(p - 1), a step of length one from zero."""
        z = tableau.a @ (power * tableau.c ** (power - 1))
        return float(tableau.start_weight * (power == 1) + tableau.error_weights @ z)

    assert max(abs(estimate(power)) for power in range(1, tableau.error_order)) < 1e-13
    assert abs(estimate(tableau.error_order)) > 1e-3


def test_the_weights_of_the_estimate_are_those_of_radau5() -> None:
    published = np.array([-13 - 7 * 6**0.5, -13 + 7 * 6**0.5, -1]) / 3
    np.testing.assert_allclose(RADAU_IIA5.error_weights / RADAU_IIA5.start_weight, published, atol=1e-13)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"b": [0.5, 0.5, 0.0]}, "b must have shape"),
        ({"a": [[0.25, 0.25]]}, "a must have shape"),
        ({"a": [[0.25, 0.25], [0.5, 0.25]]}, "row 0 of a does not integrate"),
        ({"b": [0.6, 0.4]}, "b does not integrate"),
        ({"c": [0.8, 0.2]}, "grows from above 0"),
        ({"c": [0.0, 1.0]}, "grows from above 0"),
        ({"c": [0.5, 1.5]}, "grows from above 0"),
        ({"c": [0.5, np.nan]}, "not finite"),
        ({"a": "abc"}, "a expects real numbers"),
        ({"order": 0}, "positive whole number"),
        ({"order": True}, "positive whole number"),
    ],
)
def test_what_is_no_tableau_is_refused(unchecked: None, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(tx.ModelError, match=message) as caught:
        dataclasses.replace(GAUSS_LEGENDRE4, **changes)
    assert "Gauss-Legendre 4" in str(caught.value)


def test_tableaus_are_read_only_and_listed() -> None:
    assert [tableau.order for tableau in IMPLICIT] == [1, 3, 4, 5, 6, 9]
    assert not set(map(id, IMPLICIT)) & set(map(id, tx.tableaus.ALL))
    with pytest.raises(ValueError, match="read-only"):
        RADAU_IIA5.a[0, 0] = 1.0
