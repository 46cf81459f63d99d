"""What people ask of a solution: outputs and controls along it, tables of it, other numbers of rows."""

import csv
import dataclasses
import functools
import sys
import types
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import twistax as tx
from compilations import compilations

TIMES = np.array([0.0, 0.5, 0.75, 2.0])
HELD = tx.ZeroOrderHold([0.0, 0.5, 1.0], [1.0, -2.0, 3.0])
#: x' = F by hand.
XS = np.array([0.0, 0.5, 0.0, 2.5])


@functools.cache
def cart() -> tx.Dynamics:
    """x' = F, with a rotation that turns about z; outputs read state, control, time and a parameter rates do not."""
    x, R, F, k = tx.State("x"), tx.State("R", group=tx.SO3), tx.Control("F"), tx.Parameter("k", value=2.0)
    outputs = {"power": k * F * x, "late": 3.0 * tx.Time(), "a": tx.Concat(x, -x)}
    return tx.compile(tx.System(rates={x: F, R: np.array([0.0, 0.0, 0.1])}, outputs=outputs))


def start(dtype: Any = np.float64) -> dict[str, Any]:
    return {"x": np.zeros((), dtype), "R": np.eye(3, dtype=dtype)}


def flown(dtype: Any = np.float64, **options: Any) -> tx.Solution:
    return tx.integrate(cart(), start(dtype), t1=2.0, u={"F": HELD}, **({"dt": 0.25, "save_at": TIMES} | options))


def test_outputs_and_controls_are_those_at_the_saved_times() -> None:
    solution = flown(params={"k": 4.0})
    np.testing.assert_allclose(solution.xs["x"], XS, atol=1e-14)
    F = np.array([1.0, -2.0, -2.0, 3.0])  # from a jump on the new value
    np.testing.assert_array_equal(solution.us["F"], F)
    np.testing.assert_allclose(solution.outputs["power"], 4.0 * F * XS, atol=1e-14)
    np.testing.assert_allclose(solution.outputs["late"], 3.0 * TIMES)
    np.testing.assert_allclose(solution.outputs["a"], np.stack([XS, -XS], 1), atol=1e-14)


def test_the_last_row_is_a_start() -> None:
    solution = flown()
    assert solution.last["R"].shape == (3, 3)
    assert solution.last["x"] == solution.xs["x"][-1]
    batch = jax.vmap(lambda x: tx.integrate(cart(), {"x": x, "R": np.eye(3)}, t1=1.0, steps=4, u={"F": 2.0}))(TIMES)
    np.testing.assert_allclose(batch.last["x"], TIMES + 2.0, rtol=1e-14)
    assert batch.last["R"].shape == (4, 3, 3)
    assert repr(solution) == "Solution(ts (4,), R (4, 3, 3), x (4,); SUCCESS: the end time was reached)"
    assert repr(batch) == "Solution(ts (4, 1), R (4, 1, 3, 3), x (4, 1); a batch, or traced)"
    tangent = dataclasses.replace(solution, code=np.zeros((), jax.dtypes.float0))
    assert repr(tangent) == "Solution(ts (4,), R (4, 3, 3), x (4,); abstract values)"


@pytest.mark.slow
def test_single_precision_stays_so() -> None:
    single = flown(np.float32)
    assert single.outputs["power"].dtype == single.us["F"].dtype == np.float32
    np.testing.assert_allclose(single.outputs["power"], 2.0 * np.array([1.0, -2.0, -2.0, 3.0]) * XS, atol=1e-6)


def test_a_first_order_hold_is_read_up_to_its_end() -> None:
    ramp = tx.FirstOrderHold([0.0, 2.0], [0.0, 1.0])
    solution = tx.integrate(cart(), start(), t1=2.0, dt=0.25, u={"F": ramp}, save_at=TIMES)
    np.testing.assert_allclose(solution.us["F"], TIMES / 2.0, atol=1e-12)


def test_of_a_batch_and_inside_of_jit() -> None:
    @jax.jit
    def fly(x: jax.Array) -> tx.Solution:
        return tx.integrate(cart(), {**start(), "x": x}, t1=2.0, dt=0.25, u={"F": HELD}, save_at=TIMES)

    starts = jnp.array([0.0, 1.0])
    batch = jax.vmap(fly)(starts)
    wanted = 2.0 * np.array([1.0, -2.0, -2.0, 3.0]) * (np.asarray(starts)[:, None] + XS)
    np.testing.assert_allclose(batch.outputs["power"], wanted, atol=1e-14)
    np.testing.assert_allclose(fly(starts[1]).outputs["power"], wanted[1], atol=1e-14)
    inside = jax.jit(jax.vmap(lambda x: fly(x).outputs["power"]))(starts)
    np.testing.assert_allclose(inside, wanted, atol=1e-14)
    with pytest.raises(tx.InputError, match="a table expects one solution, got a batch"):
        batch.to_csv("never.csv")
    with pytest.raises(tx.InputError, match="a table expects numbers, got a solution that is traced"):
        jax.eval_shape(lambda x: fly(x).to_csv("never.csv"), starts[1])


def test_rows_that_were_not_reached_have_no_outputs_and_lost_values_are_named() -> None:
    x = cart().states[0]

    def fly(force: jax.Array) -> tx.Solution:
        stop = tx.Event(x > 0.75)
        return tx.integrate(
            cart(), start(), t1=2.0, dt=0.25, u=lambda t: {"F": force + 0.0 * t}, save_at=TIMES, event=stop
        )

    late = jax.vmap(lambda force: fly(force).outputs["late"])(jnp.array([1.0, 0.25]))
    np.testing.assert_allclose(late, 3.0 * np.array([[0.0, 0.5, 0.75, np.nan, 0.75], [*TIMES, 2.0]]), atol=1e-12)
    with pytest.raises(tx.InputError, match=r"u reads values that existed only within jax\.vmap"):
        _ = jax.vmap(fly)(jnp.array([1.0, 0.25])).us


def test_truth_values_stay_so() -> None:
    x = tx.State("x")
    falling = tx.compile(tx.System(rates={x: -1.0 + 0.0 * x}, outputs={"low": x < 0.5}))
    low = tx.integrate(falling, {"x": 1.0}, t1=1.0, dt=0.5, save_at=[0.0, 0.25, 1.0]).outputs["low"]
    assert low.dtype == bool
    assert low.tolist() == [False, False, True]


def test_an_output_of_what_was_not_given_is_named() -> None:
    x, F, w = tx.State("x"), tx.Control("F"), tx.Parameter("w")
    without = tx.compile(tx.System(rates={x: -x}, outputs={"push": F * x}))
    with pytest.raises(tx.InputError, match="an output reads the control 'F'"):
        _ = tx.integrate(without, {"x": 1.0}, t1=1.0, dt=0.5).outputs
    without = tx.compile(tx.System(rates={x: -x}, outputs={"push": w * x}))
    with pytest.raises(tx.InputError, match="Parameter 'w' has no value"):
        _ = tx.integrate(without, {"x": 1.0}, t1=1.0, dt=0.5).outputs


def test_a_table_has_units_and_all_digits(tmp_path: Path) -> None:
    layout = tx.columns.Columns(units={"x": "m", "a": ["m", "ft"]}, rotations=tx.columns.EULER)
    solution, path = flown(), tmp_path / "flight.csv"
    solution.to_csv(path, layout)
    with path.open(newline="") as file:
        header, *rows = list(csv.reader(file))
    angles = ["R.roll [rad]", "R.pitch [rad]", "R.yaw [rad]"]
    assert header == ["t [s]", "x [m]", *angles, "F", "power", "late", "a[0] [m]", "a[1] [ft]"]
    found = np.array(rows, float)
    np.testing.assert_array_equal(found[:, 1], solution.xs["x"])
    np.testing.assert_allclose(found[:, 4], 0.1 * TIMES, atol=1e-14)
    solution.to_csv(path)
    quaternions = np.loadtxt(path, delimiter=",", skiprows=1)[:, 2:6]
    np.testing.assert_allclose(quaternions[:, [0, 3]], np.stack([np.cos(0.05 * TIMES), np.sin(0.05 * TIMES)], 1))


def test_bad_tables_are_refused(tmp_path: Path) -> None:
    solution = flown()
    with pytest.raises(tx.InputError, match=r"units names 'lat'; the columns are of: .*\n  fix: did you mean 'late'"):
        solution.to_csv(tmp_path / "a.csv", tx.columns.Columns(units={"lat": "m"}))
    with pytest.raises(tx.ShapeError, match="units of 'a' expects one text or a list of 2, got 1"):
        solution.to_csv(tmp_path / "a.csv", tx.columns.Columns(units={"a": ["m"]}))
    with pytest.raises(tx.InputError, match="to_csv cannot write"):
        solution.to_csv(tmp_path / "nowhere" / "a.csv")
    with pytest.raises(tx.ModelError, match="layout expects one like"):
        solution.to_csv(tmp_path / "a.csv", {"x": "m"})

    class Own(tx.columns.Layout):
        def columns(self, solution: tx.Solution) -> Any:
            return found

    found: Any = [tx.columns.Column("x", "m", np.zeros(3))]
    with pytest.raises(tx.ShapeError, match=r"column 'x \[m\]' expects a number for each of 4 saved times"):
        solution.to_csv(tmp_path / "a.csv", Own())
    found = {"x": np.zeros(4)}
    with pytest.raises(tx.ModelError, match=r"Own.columns must return a list of tx.columns.Column"):
        solution.to_csv(tmp_path / "a.csv", Own())
    assert not list(tmp_path.iterdir())
    with pytest.raises(tx.ModelError, match="the unit of 'x' must be a text"):
        tx.columns.Columns(units={"x": 1})


def test_a_data_frame_or_the_name_of_what_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(tx.ModelError, match="to_dataframe needs pandas"):
        flown().to_dataframe()
    monkeypatch.setitem(sys.modules, "pandas", types.SimpleNamespace(DataFrame=dict))
    frame = flown().to_dataframe()
    assert list(frame)[:3] == ["t [s]", "x", "R.qw"]
    np.testing.assert_allclose(frame["x"], XS, atol=1e-14)
    with pytest.raises(tx.InputError, match=r"two columns have the header 'a\[1\] \[m\]'"):
        flown().to_dataframe(_Twice())


class _Twice(tx.columns.Layout):
    """A column that is there two times."""

    def columns(self, solution: tx.Solution) -> list[tx.columns.Column]:
        return [tx.columns.Column("a[1]", "m", solution.ts)] * 2


@pytest.mark.parametrize("way", [{"dt": 0.25}, pytest.param({"rtol": 1e-6}, marks=pytest.mark.slow)])
def test_other_rows_and_another_table_compile_nothing(way: dict[str, float]) -> None:
    def fly(rows: int, last: float) -> tx.Solution:
        table = {"F": tx.ZeroOrderHold([0.0, 0.5, 1.0], [1.0, -2.0, last])}
        saves = np.linspace(0.0, 2.0, rows)
        solution = tx.integrate(cart(), start(), t1=2.0, u=table, save_at=saves, **way)
        assert solution.ts.shape == solution.outputs["late"].shape == (rows,)
        np.testing.assert_allclose(solution.ts, saves)
        assert float(np.asarray(solution.xs["x"])[-1]) == pytest.approx(last - 0.5, abs=1e-9)
        return solution

    fly(5, 3.0)
    with compilations() as more:
        fly(33, 1.0)
    assert not more
    with compilations() as more:
        jax.jit(lambda a: a - 1.0)(1.0)
    assert more


@pytest.mark.slow
def test_another_level_of_an_event_compiles_nothing() -> None:
    x = cart().states[0]

    def fly(level: float) -> float:
        # Simplified the first one would be a sum without a level.
        event = [tx.Event(~((x + 1.0) < level + 1.0)), tx.Event(-1.0 - level - x)]
        found = tx.integrate(cart(), start(), t1=2.0, dt=0.25, u={"F": np.asarray(1.0)}, event=event)
        assert found.event == 0
        return float(found.ts[-1])

    assert fly(1.3) == pytest.approx(1.3)
    with compilations() as more:
        assert fly(0.6) == pytest.approx(0.6)
    assert not more


METHODS = {
    "DOP853": (None, 6),
    "TSIT5": (tx.RKMK(tx.tableaus.TSIT5), 4),
    "DORMAND_PRINCE8": (tx.RKMK(tx.tableaus.DORMAND_PRINCE8), 5),
}


@functools.cache
def bent() -> tx.Dynamics:
    """A rotation about an axis that moves, and a number that is bent by both."""
    R, x, t = tx.State("R", group=tx.SO3), tx.State("x"), tx.Time()
    return tx.compile(tx.System(rates={R: tx.Concat(tx.Sin(t), 1.0 - x, R[0, 1]), x: tx.Cos(t) * x + R[2, 0]}))


@pytest.mark.parametrize(
    "name", ["DOP853", *(pytest.param(n, marks=pytest.mark.slow) for n in ("TSIT5", "DORMAND_PRINCE8"))]
)
def test_a_polynomial_has_its_order_and_costs_no_evaluations(name: str) -> None:
    """Of steps of one length: halving it divides what is off by two to the order + 1 in the middle of the first."""
    method, order = METHODS[name]
    begin = {"R": np.eye(3), "x": 1.0}

    def off(h: float) -> float:
        saves = np.array([0.0, 0.4 * h, 0.77 * h, h])
        own = {"dt": h, "rtol": 0.5, "method": method, "save_at": saves, "t1": h}
        found = tx.integrate(bent(), begin, between=tx.Between.POLYNOMIAL, **own)
        exact = tx.integrate(bent(), begin, t1=h, rtol=1e-13, save_at=saves)
        assert found.stats.steps == 1
        assert float(jnp.max(jax.vmap(tx.SO3.defect)(found.xs["R"]))) < 1e-14
        np.testing.assert_array_equal(found.xs["x"][0], 1.0)
        plain = tx.integrate(bent(), begin, **own | {"save_at": None})
        assert found.stats.rhs_evaluations == plain.stats.rhs_evaluations
        np.testing.assert_allclose(found.xs["x"][-1], plain.xs["x"][-1], rtol=1e-15)
        return max(float(np.abs(found.xs[k][1:3] - exact.xs[k][1:3]).max()) for k in found.xs)

    seen = np.log2(off(0.4) / off(0.2))
    assert seen == pytest.approx(order + 1, abs=0.7)


def test_polynomials_stop_at_jumps_and_events_and_have_derivatives() -> None:
    polynomial = {"between": tx.Between.POLYNOMIAL, "rtol": 1e-8}
    solution = flown(dt=None, **polynomial)
    np.testing.assert_allclose(solution.xs["x"], XS, atol=1e-12)
    x = cart().states[0]
    ended = flown(dt=None, event=tx.Event(x - 0.25, direction=False), **polynomial)
    assert ended.event == 0
    np.testing.assert_allclose(ended.ts, [0.0, 0.5, 0.625], atol=1e-12)
    np.testing.assert_allclose(ended.xs["x"], [0.0, 0.5, 0.25], atol=1e-12)

    def middle(force: jax.Array) -> jax.Array:
        found = tx.integrate(cart(), start(), t1=2.0, u={"F": force}, save_at=[0.3, 1.1], **polynomial)
        return found.xs["x"][1]

    assert float(jax.grad(middle)(jnp.asarray(2.0))) == pytest.approx(1.1)


def test_what_has_no_polynomial_says_so() -> None:
    with pytest.raises(tx.InputError, match="between applies to adaptive steps"):
        flown(between=tx.Between.POLYNOMIAL)
    method = tx.ImplicitRKMK(tx.tableaus.RADAU_IIA5)
    with pytest.raises(tx.ModelError, match="has no polynomial between the ends of its steps"):
        flown(dt=None, rtol=1e-6, method=method, between=tx.Between.POLYNOMIAL)


@pytest.mark.usefixtures("unchecked")
def test_another_word_for_a_polynomial_is_refused() -> None:
    with pytest.raises(tx.InputError, match=r"between expects tx\.Between\.STEP or tx\.Between\.POLYNOMIAL, got"):
        flown(dt=None, rtol=1e-6, between="cubic")
