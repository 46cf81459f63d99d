"""Every method converges with its order on a body for which nothing commutes and nothing is symmetric."""

import numpy as np
import pytest
from integrator_bodies import forced, forced_body, forced_body_reference, start

import twistax as tx
from twistax.groups import se3
from twistax.tableaus import ALL, EULER, RK4, ButcherTableau

END = 1.0


@pytest.fixture(scope="module")
def reference() -> dict[str, np.ndarray]:
    return forced_body_reference(start(), END)


#: The fewest steps of the fit, by order: enough to converge, and errors stay above round-off with four times as many.
FEWEST = {1: 160, 2: 40, 3: 40, 4: 30, 5: 30, 8: 6}


def fitted_order(dynamics: tx.Dynamics, method: tx.RKMK, reference: dict[str, np.ndarray]) -> float:
    """The slope of log error over log step, errors well above round-off and steps small enough to converge."""
    counts = np.array([2, 3, 4, 6, 8]) * FEWEST[method.tableau.order] // 2
    errors = []
    for count in counts:
        end = tx.integrate(dynamics, start(), t1=END, steps=int(count), method=method).xs
        errors.append(max(np.abs(end[name][-1] - reference[name]).max() for name in reference))
    assert min(errors) > 2e-13
    return -np.polyfit(np.log(counts), np.log(errors), 1)[0]


@pytest.mark.parametrize("tableau", ALL, ids=lambda tableau: tableau.name)
def test_the_order_is_what_the_tableau_says(tableau: ButcherTableau, reference: dict[str, np.ndarray]) -> None:
    assert fitted_order(forced(), tx.RKMK(tableau), reference) == pytest.approx(tableau.order, abs=0.15)


def test_the_fit_sees_the_inverse_left_jacobian(
    monkeypatch: pytest.MonkeyPatch, reference: dict[str, np.ndarray]
) -> None:
    right = se3.pulled_back
    monkeypatch.setattr(se3, "pulled_back", lambda eta, omega, d, rise: right(tuple(-e for e in eta), omega, d, rise))
    assert fitted_order(tx.compile(forced_body()), tx.RKMK(RK4), reference) < 2.2


def test_the_fit_sees_a_wrong_label(reference: dict[str, np.ndarray]) -> None:
    mislabelled = ButcherTableau("mislabelled", 2, EULER.a, EULER.b, EULER.c)
    assert fitted_order(forced(), tx.RKMK(mislabelled), reference) == pytest.approx(1.0, abs=0.15)
