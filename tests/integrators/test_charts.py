"""Charts: their coordinates are coordinates, every tableau keeps its order in every chart, and bad ones are named."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from integrator_bodies import forced, forced_body_reference, start
from scipy.linalg import expm
from test_order import END, STARTS, fitted_order

import twistax as tx
from registered import concrete_classes
from twistax.charts import Ambient, Chart, Exponential, SplitExponential
from twistax.groups import Group, SpecialEuclidean
from twistax.integrators import VectorField
from twistax.tableaus import ALL, DOP853, RK4, ButcherTableau

CLOSED: list[Chart] = [Exponential(), SplitExponential()]
#: Every chart of the package, as it is without arguments; the others leave the group between the ends of a step.
CHARTS: list[Chart] = [*CLOSED, *(cls() for cls in concrete_classes(Chart) if cls() not in CLOSED)]
GROUPS = [tx.SO3, tx.SE3, SpecialEuclidean(tx.ANGULAR_FIRST)]


def hat(group: Group, omega: np.ndarray) -> np.ndarray:
    """The matrix of the algebra, written out."""
    if group is tx.SO3:
        x, y, z = omega
        return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    v, w = (omega[:3], omega[3:]) if group == tx.SE3 else (omega[3:], omega[:3])
    return np.block([[hat(tx.SO3, w), v[:, None]], [np.zeros((1, 4))]])


def element(group: Group, seed: int) -> np.ndarray:
    return expm(hat(group, np.random.default_rng(seed).normal(size=group.dimension)))


@pytest.mark.parametrize("group", GROUPS, ids=lambda group: group.name)
@pytest.mark.parametrize("chart", CHARTS, ids=repr)
def test_coordinates_follow_the_rate(chart: Chart, group: Group) -> None:
    """d/ds of the state at z + s slope is g omega^, at z = 0 and, where the chart stays in the group, elsewhere."""
    local = chart.coordinates(group)
    rng = np.random.default_rng(3)
    g, omega = jnp.asarray(element(group, 1)), rng.normal(size=group.dimension)
    y, rate = local.enter(g), local.rate(jnp.asarray(omega))
    np.testing.assert_allclose(local.value(y), g, atol=1e-15)
    first = local.first_slope(y, rate)
    zero = tuple(jnp.zeros(()) for _ in first)
    points = [zero] + ([tuple(jnp.asarray(rng.normal(size=len(first)))) for _ in range(3)] if chart in CLOSED else [])
    for z in points:
        moved = local.move(y, z)
        slope = local.slope(z, moved, rate)
        value, change = jax.jvp(lambda z: local.value(local.move(y, z)), (z,), (slope,))
        np.testing.assert_allclose(change, np.asarray(value) @ hat(group, omega), atol=2e-14)
        np.testing.assert_allclose(local.value(local.settle(moved)), value, atol=1e-15)
    np.testing.assert_allclose(jnp.stack(local.slope(zero, local.move(y, zero), rate)), jnp.stack(first), atol=1e-15)


@pytest.mark.parametrize("group", GROUPS[:2], ids=lambda group: group.name)
@pytest.mark.parametrize("commutators", [1, 2, 3, 4, 6])
def test_commutators_cut_off_at_their_power(group: Group, commutators: int) -> None:
    """What is left out is the next even power: ad^2 after 1, ad^4 after 2 and 3, and so on."""
    exact, cut = Exponential().coordinates(group), Exponential(commutators).coordinates(group)
    rng = np.random.default_rng(5)
    z, rate = (tuple(jnp.asarray(rng.normal(size=group.dimension))) for _ in range(2))

    def error(size: float) -> float:
        here = tuple(size * a for a in z)
        return float(jnp.abs(jnp.stack(exact.slope(here, (), rate)) - jnp.stack(cut.slope(here, (), rate))).max())

    missing = 2 * (commutators // 2) + 2
    assert np.log2(error(0.2) / error(0.1)) == pytest.approx(missing, abs=0.15)


@pytest.fixture(scope="module")
def references() -> list[dict[str, np.ndarray]]:
    return [forced_body_reference(x, END) for x in STARTS]


#: A tableau is right or wrong in every chart, and a chart shows its errors to the tableaus of high order. That every
#: tableau has its order is seen in test_order; in closed form the others are among the slow tests.
ORDERS = [(tableau, chart) for tableau in (RK4, DOP853) for chart in CHARTS]
MORE = [(tableau, CHARTS[0]) for tableau in ALL if tableau not in (RK4, DOP853)]


@pytest.mark.parametrize(
    ("tableau", "chart"),
    [*ORDERS, *(pytest.param(*more, marks=pytest.mark.slow) for more in MORE)],
    ids=[f"{t.name}, {chart!r}" for t, chart in ORDERS + MORE],
)
def test_every_tableau_keeps_its_order(
    tableau: ButcherTableau, chart: Chart, references: list[dict[str, np.ndarray]]
) -> None:
    """The fits of the commutators that the order needs are in test_order."""
    assert fitted_order(forced(), tx.RKMK(tableau, chart), references) == pytest.approx(tableau.order, abs=0.15)


def test_two_commutators_are_too_few_for_order_eight(references: list[dict[str, np.ndarray]]) -> None:
    assert fitted_order(forced(), tx.RKMK(DOP853, Exponential(2)), references) < 6.0


@pytest.mark.parametrize("chart", [*CHARTS, Exponential(2)], ids=repr)
def test_long_solutions_stay_in_the_group(chart: Chart) -> None:
    sol = tx.integrate(forced(), start(), t1=200.0, dt=1e-2, method=tx.RKMK(RK4, chart))
    assert float(tx.SE3.defect(sol.xs["g"][0])) < 1e-14


def test_more_than_half_a_turn_in_a_step_is_a_failure() -> None:
    R = tx.State("R", group=tx.SO3)
    spin = tx.compile(tx.System(rates={R: np.array([0.0, 0.0, 4.0])}))
    with pytest.raises(tx.IntegrationError, match="'R' became infinite or NaN"):
        tx.integrate(spin, {"R": np.eye(3)}, t1=1.0, steps=1)
    closed = tx.integrate(spin, {"R": np.eye(3)}, t1=1.0, steps=1, method=tx.RKMK(RK4, Exponential()))
    np.testing.assert_allclose(closed.xs["R"][0], expm(hat(tx.SO3, np.array([0.0, 0.0, 4.0]))), atol=1e-14)


@pytest.mark.parametrize("chart", [None, *CLOSED], ids=repr)
def test_a_turn_too_far_is_said_to_be_one(chart: Chart | None) -> None:
    """A pose that spins up: the step before is fine, and in closed form it takes more than a full turn."""
    g, V = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,))
    spin = tx.compile(tx.System(rates={g: V, V: tx.Time() * np.array([0.0, 0.0, 0.0, 0.0, 0.0, 20.0])}))
    start, t = {"g": np.eye(4), "V": np.zeros(6)}, "0.8" if chart is None else "1.2"
    with pytest.raises(tx.IntegrationError, match=rf"'g' became .* t = {t} s.\n  likely cause: 'g' rotates by about"):
        tx.integrate(spin, start, t1=2.0, dt=0.4, method=tx.RKMK(RK4, chart))


def test_a_quaternion_that_overflows_is_no_rotation() -> None:
    R = tx.State("R", group=tx.SO3)
    spin = tx.compile(tx.System(rates={R: np.array([0.0, 0.0, 1e60])}))
    with pytest.raises(tx.IntegrationError, match="'R' became infinite or NaN"):
        tx.integrate(spin, {"R": np.eye(3)}, t1=1.0, steps=1, method=tx.RKMK(RK4, Ambient()))


def test_the_increment_is_the_step() -> None:
    """x (+) increment is where the step ends, in exponential coordinates; other charts say what to use."""
    dynamics = forced()
    inputs = dynamics.functions.prepare(0.3, start())
    field = VectorField(dynamics, lambda t: {}, dict(inputs.params))
    arguments = (field, inputs.t, dict(inputs.x), jnp.asarray(0.1))
    for method in (tx.RKMK(RK4), tx.RKMK(DOP853, Exponential())):
        eta, end = jax.jit(lambda m=method: (m.increment(*arguments), m.step(*arguments)))()
        there = dynamics.group.retract(inputs.x, jnp.concatenate([eta[name] for name in dynamics.group.factors]))
        for name in end:
            np.testing.assert_allclose(there[name], end[name], atol=1e-14)
    for chart in (SplitExponential(), Ambient()):
        with pytest.raises(tx.ModelError, match="derivatives of steps need exponential coordinates"):
            tx.RKMK(RK4, chart).increment(*arguments)


def test_charts_are_values() -> None:
    assert tx.RKMK(RK4) == tx.RKMK(RK4, Exponential(commutators=2))
    assert tx.RKMK(RK4, Ambient()) != tx.RKMK(RK4)
    assert Exponential(2) != SplitExponential(2)


@pytest.mark.usefixtures("unchecked")
def test_commutators_are_counted_in_whole_numbers() -> None:
    for commutators in (0, -1, 1.5):
        with pytest.raises(tx.ModelError, match="commutators must be a positive whole number"):
            Exponential(commutators)  # type: ignore[arg-type]


@pytest.mark.usefixtures("unchecked")
def test_methods_need_a_tableau_and_a_chart() -> None:
    with pytest.raises(tx.ModelError, match=r"RKMK expects a tableau like tx\.tableaus\.RK4, got 'RK4'"):
        tx.RKMK("RK4")  # type: ignore[arg-type]
    with pytest.raises(tx.ModelError, match=r"RKMK expects a chart like tx\.charts\.Exponential\(\), got 'ambient'"):
        tx.RKMK(RK4, "ambient")  # type: ignore[arg-type]


def by_another_name() -> Group:
    """SO(3) as a group that no chart knows: every member is handed on."""

    def handed_on(name: str) -> object:
        member = getattr(tx.SO3, name)
        return staticmethod(member) if callable(member) else property(lambda self: member)

    members = {name: handed_on(name) for name in Group.__abstractmethods__ if name != "name"}
    return type("Turns", (Group,), members | {"name": property(lambda self: "Turns"), "tighten": tx.SO3.tighten})()


@pytest.mark.parametrize("chart", CHARTS, ids=repr)
def test_a_group_of_your_own_is_integrated_in_every_chart(chart: Chart) -> None:
    def solve(group: Group, method: tx.RKMK) -> np.ndarray:
        R, w = tx.State("R", group=group), tx.State("w", shape=(3,))
        J = np.array([1.0, 2.0, 3.0])
        spin = tx.compile(tx.System(rates={R: w, w: tx.linalg.Cross(J * w, w) / J + R.T @ np.array([0.0, 0.1, 0.3])}))
        return tx.integrate(spin, {"R": np.eye(3), "w": J}, t1=1.0, dt=0.02, method=method).xs["R"][0]

    known = solve(tx.SO3, tx.RKMK(RK4, Exponential()))
    np.testing.assert_allclose(solve(by_another_name(), tx.RKMK(RK4, chart)), known, atol=1e-13)
