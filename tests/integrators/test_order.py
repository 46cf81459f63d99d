"""Every method converges with its order on a body for which nothing commutes and nothing is symmetric."""

import numpy as np
import pytest
from integrator_bodies import forced, forced_body, forced_body_reference, start

import twistax as tx
from twistax.groups import SpecialEuclidean, se3
from twistax.tableaus import ALL, EULER, RK4, ButcherTableau

END = 1.0


@pytest.fixture(scope="module")
def reference() -> dict[str, np.ndarray]:
    return forced_body_reference(start(), END)


def fitted_order(dynamics: tx.Dynamics, tableau: ButcherTableau, reference: dict[str, np.ndarray]) -> float:
    """The slope of log error over log step, errors well above round-off and steps small enough to converge."""
    counts = np.array([40, 80, 160, 320]) * (4 if tableau.order == 1 else 1)
    errors = []
    for count in counts:
        end = tx.integrate(dynamics, start(), t1=END, dt=END / count, method=tx.RKMK(tableau)).xs
        errors.append(max(np.abs(end[name][-1] - reference[name]).max() for name in reference))
    assert min(errors) > 1e-12
    return -np.polyfit(np.log(counts), np.log(errors), 1)[0]


@pytest.mark.parametrize("tableau", ALL, ids=lambda tableau: tableau.name)
def test_the_order_is_what_the_tableau_says(tableau: ButcherTableau, reference: dict[str, np.ndarray]) -> None:
    assert fitted_order(forced(), tableau, reference) == pytest.approx(tableau.order, abs=0.15)


def test_the_fit_sees_the_inverse_left_jacobian(
    monkeypatch: pytest.MonkeyPatch, reference: dict[str, np.ndarray]
) -> None:
    monkeypatch.setattr(
        SpecialEuclidean,
        "right_jacobian_inv_apply",
        lambda self, eta, omega: se3.right_jacobian_inv_apply(-eta, omega),
    )
    assert fitted_order(tx.compile(forced_body()), RK4, reference) < 2.2


def test_the_fit_sees_a_wrong_label(reference: dict[str, np.ndarray]) -> None:
    mislabelled = ButcherTableau("mislabelled", 2, EULER.a, EULER.b, EULER.c)
    assert fitted_order(forced(), mislabelled, reference) == pytest.approx(1.0, abs=0.15)
