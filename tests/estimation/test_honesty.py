"""Verdicts on covariances, and what the data cannot tell."""

import dataclasses
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

import twistax as tx
from twistax.estimation import ErrorStateKalman, Verdict, consistency

RNG = np.random.default_rng(7)


@pytest.mark.parametrize(
    ("factor", "runs", "verdict"),
    [
        (1.0, 100, Verdict.CONSISTENT),
        (1.6, 100, Verdict.OPTIMISTIC),
        (0.6, 100, Verdict.PESSIMISTIC),
        (1.0, 2, Verdict.UNDECIDED),
        (1.0, 1, Verdict.UNDECIDED),
        (9.0, 1, Verdict.UNDECIDED),
    ],
)
def test_verdicts(factor: float, runs: int, verdict: Verdict) -> None:
    statistic = factor * np.random.default_rng(1).chisquare(3, size=(runs, 40))
    result = consistency(statistic, 3)
    assert result.verdict is verdict
    assert verdict.name in str(result)
    assert "at level 0.95" in str(result)


def test_an_honest_covariance_is_refused_as_often_as_the_level_says() -> None:
    """Of 400 experiments with 30 runs, 5 % are refused, within three standard deviations of a binomial count."""
    refused = 0
    for _ in range(400):
        result = consistency(RNG.chisquare(4, size=(30, 5)), 4)
        refused += result.verdict in (Verdict.OPTIMISTIC, Verdict.PESSIMISTIC)
    assert abs(refused - 20) < 3.0 * np.sqrt(400 * 0.05 * 0.95)


def test_the_band_is_that_of_chi_square() -> None:
    """Tables of chi-square with 50 degrees of freedom: 32.36 at 0.025 and 71.42 at 0.975."""
    result = consistency(np.random.default_rng(2).chisquare(1, size=(50, 2000)), 1)
    np.testing.assert_allclose(np.multiply(result.band, 50), [32.357, 71.420], atol=2e-3)
    assert abs(result.inside - 0.95) < 0.02


def simulated(told: float) -> Any:
    """60 runs of a random walk of density 0.5 that the filter takes for one of another density."""
    x = tx.State("x")
    kalman = ErrorStateKalman(
        tx.compile(tx.System(rates={x: tx.Noise("w", density=told)})), [tx.Measurement("y", x, covariance=0.04)]
    )
    ts, rng = 0.1 * np.arange(1, 31), np.random.default_rng(4)
    truth = rng.normal(size=(60, 1)) + np.cumsum(rng.normal(size=(60, 30)) * 0.5 * np.sqrt(0.1), axis=1)
    values = truth + 0.2 * rng.normal(size=truth.shape)
    run = jax.vmap(lambda z: kalman.run({"y": (ts, z)}, {"x": 0.0}, 1.0 + 0.5**2 * 0.1, t0=ts[0]))(values)
    return run, {"x": truth}


@pytest.mark.parametrize(
    ("told", "verdict"), [(0.5, Verdict.CONSISTENT), (0.15, Verdict.OPTIMISTIC), (2.0, Verdict.PESSIMISTIC)]
)
def test_a_filter_with_the_wrong_noise_is_found_out(told: float, verdict: Verdict) -> None:
    run, truth = simulated(told)
    assert run.consistency(truth).verdict is verdict
    assert run.innovation_consistency("y").verdict is verdict
    one = jax.tree.map(lambda a: a[0], run)
    assert one.consistency({"x": truth["x"][0]}).verdict is Verdict.UNDECIDED


def test_a_run_that_failed_has_no_verdict() -> None:
    """Without its errors the others would look consistent, whatever happened to it."""
    run, truth = simulated(0.5)
    failed = dataclasses.replace(run, P=run.P.at[7, 20:].set(np.nan))
    for verdict in (lambda: failed.consistency(truth), lambda: failed.innovation_consistency("y")):
        with pytest.raises(tx.EstimationError, match=r"not finite at t = 2\.1 s of run 7"):
            verdict()


@pytest.mark.slow
def test_the_covariance_of_an_ins_is_honest_over_200_flights(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The example with more flights; another integrator makes the truth. With Euler angles the filter is optimistic."""
    example = Path(__file__).parents[2] / "examples" / "gps_ins.py"
    source = example.read_text()
    assert "RUNS, STEP, END, OUTAGE = 40" in source
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {"__name__": "__main__"}
    with jax.numpy_rank_promotion("allow"):
        exec(compile(source.replace("OUTAGE = 40", "OUTAGE = 200"), str(example), "exec"), names)
    tests = {type(kalman).__name__: run.consistency(truth) for kalman, (run, truth) in names["results"].items()}
    assert tests["InvariantKalman"].runs == 200
    assert tests["InvariantKalman"].inside >= 0.9
    assert tests["ErrorStateKalman"].verdict is Verdict.OPTIMISTIC


def test_combinations_that_the_data_cannot_tell_are_named() -> None:
    """A position with an offset of its sensor and a drift: only sums of the first two are measured."""
    p, v, b, c = (tx.State(name) for name in ("p", "v", "b", "c"))
    dynamics = tx.compile(tx.System(rates={p: v, v: 0.0, b: 0.0, c: 0.0}))
    kalman = ErrorStateKalman(dynamics, [tx.Measurement("y", p + 2.0 * b, covariance=1.0)])
    ts = np.arange(5.0)
    run = kalman.run({"y": (ts, ts)}, {"p": 0.0, "v": 0.0, "b": 0.0, "c": 0.0}, 1.0)
    found = run.observability()
    assert found.rank == 2
    assert set(found.unobservable) == {"p - 0.5 b", "c"}
    text = run.explain()
    assert "rank 2 of 4" in text
    assert "not observable: c" in text
    gramian = sum(np.outer(row, row) for row in ([1.0, t, 2.0, 0.0] for t in ts))
    np.testing.assert_allclose(found.gramian, gramian, atol=1e-12)


def test_units_do_not_decide_what_is_observable() -> None:
    """A rate in 1e-9 of its unit is as observable as before."""
    p, v = tx.State("p"), tx.State("v")
    dynamics = tx.compile(tx.System(rates={p: 1e-9 * v, v: 0.0}))
    kalman = ErrorStateKalman(dynamics, [tx.Measurement("y", p, covariance=1e-6)])
    run = kalman.run({"y": (np.arange(5.0), np.zeros(5))}, {"p": 0.0, "v": 0.0}, [1.0, 1e18])
    assert run.observability().rank == 2


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: consistency([-1.0], 1), "non-negative"),
        (lambda: consistency([np.nan], 1), "finite"),
        (lambda: consistency([1.0], 1, level=1.0), "level"),
        (lambda: simulated(0.5)[0].nees({"y": 0.0}), "truth needs the state 'x'"),
        (lambda: simulated(0.5)[0].innovation_consistency("z"), "the run has the measurements 'y'"),
        (lambda: simulated(0.5)[0].observability(), "one run"),
    ],
)
def test_bad_arguments_are_refused(call: Any, message: str) -> None:
    with pytest.raises(tx.InputError, match=message):
        call()
