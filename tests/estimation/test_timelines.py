"""When a run begins and ends, which times it has, and covariances that are known only then."""

from typing import Any

import numpy as np
import pytest

import twistax as tx
from twistax.estimation import ErrorStateKalman

x = tx.State("x")
INTEGRATOR = tx.compile(tx.System(rates={x: tx.Control("u") + tx.Noise("w", density=0.1)}))
KALMAN = ErrorStateKalman(INTEGRATOR, [tx.Measurement("y", x, covariance=0.04)])
TABLE = tx.ZeroOrderHold([0.0, 1.0, 2.0, 3.0, 4.0], [1.0, 2.0, 3.0, 4.0, 5.0])


def run(**options: Any) -> Any:
    arguments: dict[str, Any] = {"records": {"y": ([1.5, 2.5], [0.0, 0.0])}, "u": {"u": TABLE}} | options
    return KALMAN.run(arguments.pop("records"), {"x": 0.0}, 1.0, **arguments)


def test_a_run_begins_with_its_records_and_ends_with_them() -> None:
    """Jumps of the controls before and after are no times of the run: x0 is the estimate at the first record."""
    result = run()
    np.testing.assert_array_equal(result.ts, [1.5, 2.0, 2.5])
    np.testing.assert_allclose(result.prior_P[0], [[1.0]])
    np.testing.assert_allclose(result.prior_xs["x"][1] - result.xs["x"][0], 2.0 * 0.5, atol=1e-12)


def test_more_times_reach_further() -> None:
    np.testing.assert_array_equal(run(save_at=[3.5]).ts, [1.5, 2.0, 2.5, 3.0, 3.5])
    np.testing.assert_array_equal(run(t0=0.5).ts, [0.5, 1.0, 1.5, 2.0, 2.5])


def test_measurements_count_at_their_times_in_whatever_order_they_come() -> None:
    """One that is late is where it was made; one that is missing changes nothing."""
    ts, values = np.array([0.5, 1.5, 2.5, 3.5]), np.array([0.3, 0.1, 0.4, 0.2])
    first, late = run(records={"y": (ts, values)}, t0=0.0), [2, 0, 3, 1]
    for records in ((ts[late], values[late]), (np.append(ts, 3.0)[::-1], np.append(values, np.nan)[::-1])):
        other = run(records={"y": records}, t0=0.0)
        np.testing.assert_allclose(other.xs["x"][-1], first.xs["x"][-1], atol=1e-14)
        np.testing.assert_allclose(other.P[-1], first.P[-1], atol=1e-14)
        assert int(np.sum(other.innovations["y"].used)) == 4


def test_a_filter_says_what_its_measurements_would_tell() -> None:
    """Of a position with an offset their sum and the velocity."""
    p, v, offset = tx.State("p"), tx.State("v"), tx.State("offset")
    cart = tx.compile(tx.System(rates={p: v, v: tx.Noise("force", density=0.1), offset: 0.0}))
    ranging = ErrorStateKalman(cart, [tx.Measurement("range", p + offset, covariance=0.01)])
    start = {"p": 0.0, "v": 1.0, "offset": 0.5}
    text = ranging.explain({"range": np.arange(3.0)}, start)
    assert text.startswith("observability: rank 2 of 3, condition")
    assert "not observable: p - offset" in text
    assert "rank 1 of 3" in ranging.explain({"range": [1.0]}, start, t0=0.0)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"save_at": [0.5], "t0": 1.0}, "save_at has the time 0.5, before the start t0 = 1"),
        ({"save_at": [np.inf]}, "save_at expects finite times"),
        ({"records": {"y": ([1.5, 2.5], [0.0, np.inf])}}, "finite values, or NaN where one is missing"),
    ],
)
def test_times_that_cannot_be_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(tx.InputError, match=message):
        run(**options)


def test_a_sensor_without_records_changes_nothing() -> None:
    """Its values have the shape (0, 3, 3): as many as a record of no times."""
    R = tx.State("R", group=tx.SO3)
    star = tx.Measurement("star", R, covariance=1e-6)
    kalman = ErrorStateKalman(tx.compile(tx.System(rates={R: np.zeros(3)})), [star])
    silent = kalman.run({"star": (np.zeros(0), np.zeros((0, 3, 3)))}, {"R": np.eye(3)}, 1e-4, t0=0.0, save_at=[1.0])
    np.testing.assert_allclose(silent.P[-1], 1e-4 * np.eye(3), rtol=1e-12)


@pytest.mark.parametrize("gate", [None, 0.99])
@pytest.mark.parametrize("covariance", [0.0, -0.5, -2.0])
def test_a_covariance_that_is_not_positive_in_the_run_is_named(covariance: float, gate: float | None) -> None:
    """A number is refused when the measurement is made; the value of an expression is known here."""
    variable = tx.Measurement("y", x, covariance=tx.Parameter("R"))
    kalman = ErrorStateKalman(INTEGRATOR, [variable], gate=gate)
    with pytest.raises(tx.EstimationError, match="covariance of a measurement not positive definite at t = 2 s"):
        kalman.run({"y": ([2.0], [0.0])}, {"x": 0.0}, 1.0, t0=0.0, u={"u": 0.0}, params={"R": covariance})


def test_noise_without_density_is_no_covariance() -> None:
    silent = tx.Measurement("y", x + tx.Noise("n", density=0.0), period=0.1)
    with pytest.raises(tx.EstimationError, match="not positive definite"):
        ErrorStateKalman(INTEGRATOR, [silent]).run({"y": ([2.0], [0.0])}, {"x": 0.0}, 1.0, u={"u": 0.0})


def test_a_missing_control_is_named_with_those_of_the_user() -> None:
    """Not with the controls that stand for noise."""
    with pytest.raises(tx.InputError) as error:
        KALMAN.predict(0.0, {"x": 0.0}, 1.0, 0.1)
    assert (
        str(error.value) == "Control 'u' is missing in u; the controls are: 'u'.\n  fix: pass u={'u': ...} of shape ()"
    )


def test_no_measurements_are_refused(unchecked: None) -> None:
    with pytest.raises(tx.ModelError, match="a filter expects a list"):
        ErrorStateKalman(INTEGRATOR, None)  # type: ignore[arg-type]
