"""Every method converges with its order on a body for which nothing commutes and nothing is symmetric."""

import numpy as np
import pytest
from integrator_bodies import forced, forced_body, forced_body_reference, starts

import twistax as tx
from twistax.integrators import charts
from twistax.tableaus import ALL, EULER, RK4, ButcherTableau

END = 1.0

STARTS = starts(4)

#: The fewest steps of the fit, by order: enough to converge, while errors with twice as many stay above round-off.
FEWEST = {1: 320, 2: 80, 3: 60, 4: 40, 5: 40, 8: 7}


@pytest.fixture(scope="module")
def references() -> list[dict[str, np.ndarray]]:
    return [forced_body_reference(x, END) for x in STARTS]


def fitted_order(dynamics: tx.Dynamics, method: tx.RKMK, references: list[dict[str, np.ndarray]]) -> float:
    """The slope of log error over log step, the error being the root of its mean square over all starts."""
    counts = (np.array([1.0, 1.3, 1.6, 2.0]) * FEWEST[method.tableau.order]).astype(int)
    errors = []
    for count in counts:
        ends = [tx.integrate(dynamics, x, t1=END, steps=int(count), method=method).xs for x in STARTS]
        off = [np.ravel(end[name][-1] - wanted[name]) for end, wanted in zip(ends, references) for name in wanted]
        errors.append(np.sqrt(np.mean(np.concatenate(off) ** 2)))
    assert min(errors) > 1e-12
    return -np.polyfit(np.log(counts), np.log(errors), 1)[0]


@pytest.mark.parametrize("tableau", ALL, ids=lambda tableau: tableau.name)
def test_the_order_is_what_the_tableau_says(tableau: ButcherTableau, references: list[dict[str, np.ndarray]]) -> None:
    assert fitted_order(forced(), tx.RKMK(tableau), references) == pytest.approx(tableau.order, abs=0.15)


def test_the_fit_sees_the_inverse_left_jacobian(
    monkeypatch: pytest.MonkeyPatch, references: list[dict[str, np.ndarray]]
) -> None:
    right = charts.chart.pose_rate
    monkeypatch.setattr(charts.chart, "pose_rate", lambda eta, *others: right(tuple(-e for e in eta), *others))
    assert fitted_order(tx.compile(forced_body()), tx.RKMK(RK4), references) < 2.2


def test_the_fit_sees_a_wrong_label(references: list[dict[str, np.ndarray]]) -> None:
    mislabelled = ButcherTableau("mislabelled", 2, EULER.a, EULER.b, EULER.c)
    assert fitted_order(forced(), tx.RKMK(mislabelled), references) == pytest.approx(1.0, abs=0.15)
