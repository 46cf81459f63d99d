"""Steps chosen by tolerances: every pair in every chart against exact solutions, whatever the frame; saved times."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from integrator_bodies import CENTRE, GRAVITY, MASS, free_body, spatial_inertia, start
from scipy.spatial.transform import Rotation

import twistax as tx
from compilations import compilations
from twistax.jax_inside import all_equations
from twistax.scenes import SCENES

PAIRS = [tableau for tableau in tx.tableaus.ALL if tableau.is_pair]
CHARTS = {
    "default": None,
    "closed": tx.charts.Exponential(),
    "split": tx.charts.SplitExponential(),
    "ambient": tx.charts.Ambient(),
}
TUMBLE = SCENES["offset-tumble"]


def end_of(sol: tx.Solution) -> dict[str, np.ndarray]:
    return {name: np.asarray(value[-1]) for name, value in sol.xs.items()}


def slope(method: tx.RKMK, tols: tuple[float, ...]) -> tuple[float, float]:
    """How the error of a solution falls with the tolerance, on double logarithmic axes, and the last error."""
    errors = []
    for tol in tols:
        end = end_of(TUMBLE.integrate(t1=4.0, rtol=tol, atol=tol, method=method))
        assert np.abs(end["g"][:3, :3].T @ end["g"][:3, :3] - np.eye(3)).max() < 1e-14
        errors.append(TUMBLE.error(end, 4.0))
    return float(np.polyfit(np.log(tols), np.log(errors), 1)[0]), errors[-1]


#: A pair is right or wrong in every chart: the others are among the slow tests.
PAIRS_IN_CHARTS = [
    *((tableau, "default") for tableau in PAIRS),
    *((tx.tableaus.TSIT5, chart) for chart in CHARTS if chart != "default"),
    (tx.tableaus.DOP853, "ambient"),
]
OTHERS = [
    *((tableau, "ambient") for tableau in PAIRS if tableau not in (tx.tableaus.TSIT5, tx.tableaus.DOP853)),
    (tx.tableaus.DOP853, "split"),
]


@pytest.mark.parametrize(
    ("tableau", "chart"),
    [*PAIRS_IN_CHARTS, *(pytest.param(*other, marks=pytest.mark.slow) for other in OTHERS)],
    ids=lambda value: getattr(value, "name", value),
)
def test_the_error_falls_with_the_tolerance(tableau: tx.tableaus.ButcherTableau, chart: str) -> None:
    tols = (1e-5, 1e-6, 1e-7, 1e-8) if tableau.order < 5 else (1e-5, 1e-7, 1e-8, 1e-9, 1e-10)
    found, error = slope(tx.RKMK(tableau, CHARTS[chart]), tols)
    assert 0.8 < found < 1.2
    assert 0.1 * tols[-1] < error < 50.0 * tols[-1]


@pytest.mark.parametrize(
    ("steps", "method"),
    [({"rtol": 1e-8}, tx.RKMK(tx.tableaus.DOP853, tx.charts.Ambient())), ({"dt": 0.1}, tx.RKMK(tx.tableaus.RK4))],
    ids=["tolerances", "fixed"],
)
def test_what_is_taken_without_a_method(steps: dict[str, float], method: tx.RKMK) -> None:
    """What the report advises for tolerances, and the classical method for fixed steps: nothing compiles again."""
    expected = TUMBLE.integrate(t1=1.0, method=method, **steps)
    with compilations() as more:
        found = TUMBLE.integrate(t1=1.0, **steps)
    assert not more
    assert found.stats == expected.stats
    np.testing.assert_array_equal(found.xs["g"], expected.xs["g"])


@pytest.mark.parametrize("tableau", [tx.tableaus.TSIT5, tx.tableaus.DOP853], ids=lambda tableau: tableau.name)
def test_a_wrong_embedded_weight_would_show(tableau: tx.tableaus.ButcherTableau) -> None:
    """The estimate then falls too slowly, and steps shrink more than the tolerance asks."""
    fields = {f: getattr(tableau, f) for f in ("order", "a", "b", "c", "embedded_order", "b_embedded")}
    if tableau.b_second_embedded is not None:
        fields |= {f: getattr(tableau, f) for f in ("second_embedded_order", "b_second_embedded")}
    off = np.zeros(tableau.stages)
    off[0], off[len(tableau.counted.c) - 1] = 1e-3, -1e-3
    wrong = tx.tableaus.ButcherTableau("wrong", **fields | {"b_embedded": fields["b_embedded"] + off})
    found, error = slope(tx.RKMK(wrong), (1e-5, 1e-6, 1e-7))
    assert found > 1.3 or error < 1e-9


@pytest.mark.parametrize("name", ["euler-top", "heavy-top", "rocket", "low-orbit"])
def test_other_scenes_reach_their_truth(name: str) -> None:
    """The error of a whole solution is larger than that of a step by what the scene makes of it."""
    scene = SCENES[name]
    method = tx.RKMK(tx.tableaus.DORMAND_PRINCE8)
    loose, tight = (scene.error(end_of(scene.integrate(rtol=tol, atol=tol, method=method))) for tol in (1e-6, 1e-9))
    assert tight < 1e-6
    assert 100.0 < loose / tight < 1e4


# ---- the estimate is a tangent ---------------------------------------------------------------------------------------


@functools.cache
def lit_body(order: tx.Order = tx.LINEAR_FIRST) -> tx.Dynamics:
    """A forced body whose world has two directions, both parameters: gravity, and a pull that grows with height."""
    swap = [0, 1, 2, 3, 4, 5] if order == tx.LINEAR_FIRST else [3, 4, 5, 0, 1, 2]
    g, V = tx.State("g", group=tx.SE3, order=order), tx.State("V", shape=(6,))
    weight, pull = tx.Parameter("weight", value=MASS * GRAVITY), tx.Parameter("pull", value=[1.0, 2.0, -0.5])
    M = tx.Constant(spatial_inertia()[np.ix_(swap, swap)])
    force = g[:3, :3].T @ (weight - tx.linalg.Dot(pull, g[:3, 3]) * pull)
    F = tx.lie.wrench(force=force, torque=tx.linalg.Cross(CENTRE, force), order=order)
    return tx.compile(tx.System(rates={g: V, V: tx.linalg.Solve(M, F - tx.lie.AdjointDual(V, M @ V, order=order))}))


# The closed form and its series, the default, turn with the frame alike.
@pytest.mark.parametrize("chart", ["default", "split", "ambient", pytest.param("closed", marks=pytest.mark.slow)])
def test_another_world_frame_takes_the_same_steps(chart: str) -> None:
    turn = Rotation.from_rotvec([0.7, -1.9, 1.1]).as_matrix()
    turned = np.eye(4)
    turned[:3, :3] = turn
    method = tx.RKMK(tx.tableaus.TSIT5, CHARTS[chart])

    def solve(frame: np.ndarray) -> tx.Solution:
        x0 = start() | {"g": frame @ start()["g"]}
        params = {"weight": frame[:3, :3] @ (MASS * GRAVITY), "pull": frame[:3, :3] @ np.array([1.0, 2.0, -0.5])}
        return tx.integrate(lit_body(), x0, t1=3.0, rtol=1e-6, atol=1e-6, params=params, method=method)

    one, other = solve(np.eye(4)), solve(turned)
    assert one.stats == other.stats
    assert one.stats.accepted > 20
    # Stages of the ambient chart are no rotations, and what is made of them depends on the frame: up to the tolerance.
    off = 1e-4 if chart == "ambient" else 3e-11
    np.testing.assert_allclose(turned @ one.xs["g"][0], other.xs["g"][0], rtol=0.0, atol=off)
    np.testing.assert_allclose(one.xs["V"], other.xs["V"], rtol=0.0, atol=off)


def test_both_twist_orders_take_the_same_steps() -> None:
    swap = [3, 4, 5, 0, 1, 2]
    atol = {"g": (1e-4, 1e-8), "V": np.array([1e-6, 1e-6, 1e-6, 1e-8, 1e-8, 1e-8])}
    by_entry = atol | {"g": np.array([1e-8, 2e-8, 1e-8, 1e-4, 1e-4, 2e-4])}
    for allowed in (atol, by_entry):
        settings = {"t1": 2.0, "rtol": 1e-12}
        linear = tx.integrate(lit_body(), start(), atol=allowed, **settings)
        x0 = start() | {"V": start()["V"][swap]}
        pose = allowed["g"] if isinstance(allowed["g"], tuple) else allowed["g"][swap]
        angular = tx.integrate(lit_body(tx.ANGULAR_FIRST), x0, atol={"g": pose, "V": allowed["V"][swap]}, **settings)
        assert linear.stats == angular.stats
        np.testing.assert_allclose(linear.xs["g"], angular.xs["g"], atol=1e-11)
        np.testing.assert_allclose(linear.xs["V"], angular.xs["V"][:, swap], atol=1e-11)


def test_an_ambient_difference_is_measured_as_a_rotation_vector() -> None:
    rng = np.random.default_rng(4)
    chart = tx.charts.Ambient()
    for group, rotation in ((tx.SO3, slice(0, 3)), (tx.SE3, slice(3, 6))):
        local = chart.coordinates(group)
        misses = []
        for size in (1e-2, 1e-3):
            q = rng.normal(size=4)
            q /= np.linalg.norm(q)
            e = size * np.array([0.3, -0.8, 0.4, 0.9])
            rest = [] if group == tx.SO3 else [0.1, 0.2, -0.3]
            after = tuple(jnp.asarray(v) for v in [*q, *(5.0 for _ in rest)])
            found = np.array(local.deviation(tuple(jnp.asarray(v) for v in [*e, *rest]), after))
            wxyz = [1, 2, 3, 0]
            between = Rotation.from_quat(q[wxyz]).inv() * Rotation.from_quat((q + e)[wxyz])
            misses.append(np.abs(found[rotation] - between.as_rotvec()).max())
            if rest:
                np.testing.assert_allclose(found[:3], rest)
        assert misses[0] < 5.0 * 1e-4
        assert misses[1] < 5.0 * 1e-6


@functools.cache
def turning() -> tx.Dynamics:
    """A pose whose twist turns with time and with another state: cheap to compile."""
    g, x, t = tx.State("g", group=tx.SE3), tx.State("s"), tx.Time()
    return tx.compile(tx.System(rates={g: tx.Concat(1.0, x, 0.3, tx.Sin(3.0 * t), tx.Cos(2.0 * t), x), x: -x + t}))


def doubles(jaxpr: object) -> set[str]:
    """The operations that give double precision, those on plain Python numbers left out."""
    values = ((equation, out.aval) for equation in all_equations(jaxpr) for out in equation.outvars)
    is_double = lambda aval: getattr(aval, "dtype", None) == jnp.float64 and not aval.weak_type  # noqa: E731
    return {f"{equation.primitive.name} {aval}" for equation, aval in values if is_double(aval)}


# ---- saved times -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("tableau", [tx.tableaus.TSIT5, tx.tableaus.DOP853], ids=lambda tableau: tableau.name)
def test_saved_states_are_as_accurate_as_the_end(tableau: tx.tableaus.ButcherTableau) -> None:
    ts = np.sort(np.concatenate([[0.0, 0.0, 3.3, 3.3, 10.0, 10.0], np.random.default_rng(5).uniform(0.0, 10.0, 58)]))
    tol, method = 1e-8, tx.RKMK(tableau)
    alone = TUMBLE.integrate(rtol=tol, atol=tol, method=method)
    sol = TUMBLE.integrate(rtol=tol, atol=tol, method=method, save_at=ts)
    np.testing.assert_array_equal(sol.ts, ts)
    assert (sol.stats.accepted, sol.stats.rejected) == (alone.stats.accepted, alone.stats.rejected)
    for name, value in TUMBLE.start.items():
        np.testing.assert_array_equal(sol.xs[name][0], value)
        np.testing.assert_array_equal(sol.xs[name][1], value)
        np.testing.assert_array_equal(sol.xs[name][-1], sol.xs[name][-2])
        np.testing.assert_allclose(sol.xs[name][-1], alone.xs[name][0], atol=1e-11)
    same = int(np.flatnonzero(ts == 3.3)[0])
    np.testing.assert_array_equal(sol.xs["g"][same], sol.xs["g"][same + 1])
    states = [{name: np.asarray(value[k]) for name, value in sol.xs.items()} for k in range(ts.size)]
    errors = np.array([TUMBLE.error(x, float(t)) for x, t in zip(states, ts, strict=True)])
    assert errors.max() < 3.0 * errors[-1]
    assert float(jnp.max(jax.vmap(tx.SE3.defect)(sol.xs["g"]))) < 1e-14


def test_saved_times_close_to_each_other_are_told_apart() -> None:
    ts = 5.0 + np.array([0.0, 1e-9, 1e-6])
    sol = TUMBLE.integrate(rtol=1e-8, atol=1e-8, save_at=ts)
    moved = [np.linalg.norm(tx.lie.so3.log(sol.xs["g"][0, :3, :3].T @ sol.xs["g"][k, :3, :3])) for k in (1, 2)]
    speed = float(np.linalg.norm(TUMBLE.truth(5.0)["V"][3:]))
    np.testing.assert_allclose(moved, speed * (ts[1:] - 5.0), rtol=1e-3, atol=0.0)


def test_a_solution_of_no_length_is_the_start() -> None:
    x0 = {"g": start()["g"], "s": np.array(0.3)}
    sol = tx.integrate(turning(), x0, t0=2.0, t1=2.0, rtol=1e-6, save_at=[2.0, 2.0])
    assert sol.result is tx.Result.SUCCESS
    assert sol.stats.steps == 0
    for name, value in x0.items():
        np.testing.assert_array_equal(sol.xs[name], [value, value])


@pytest.mark.parametrize("tableau", PAIRS, ids=lambda tableau: tableau.name)
def test_evaluations_are_counted_as_they_are_made(tableau: tx.tableaus.ButcherTableau) -> None:
    x, F = tx.State("x"), tx.Control("F")
    dynamics = tx.compile(tx.System(rates={x: F - x}))
    calls: list[float] = []

    def u(t: jax.Array) -> dict[str, jax.Array]:
        jax.debug.callback(lambda t: calls.append(float(t)), t)
        return {"F": jnp.sin(9.0 * t)}

    sol = tx.integrate(
        dynamics, {"x": 1.0}, t1=2.0, rtol=1e-5, u=u, method=tx.RKMK(tableau), save_at=[0.0, 0.31, 0.5, 0.5, 2.0]
    )
    jax.effects_barrier()
    # One more call reads the controls at the start, to check their names and shapes.
    assert sol.stats.rhs_evaluations == len(calls) - 1
    assert sol.stats.steps == sol.stats.accepted + sol.stats.rejected


# ---- numbers are inputs, and keep their precision --------------------------------------------------------------------


def test_other_numbers_do_not_compile_again() -> None:
    system = free_body()
    g, V = system.states
    M, F = system.parameters[0], tx.Control("F", shape=(6,))
    dynamics = tx.compile(tx.System(rates={g: V, V: tx.linalg.Solve(M, F - tx.lie.AdjointDual(V, M @ V))}))
    inertia = np.asarray(M.value)

    def solve(k: float, first: float | None) -> None:
        tx.integrate(
            dynamics,
            start(int(k)),
            t0=0.1 * k,
            t1=1.0 + k,
            dt=first,
            rtol=1e-4 / k,
            atol={"g": (1e-5 / k, 1e-6), "V": 1e-6 * k},
            params={"M": k * inertia},
            u={"F": tx.ZeroOrderHold(np.array([0.0, 0.6 * k]), k * np.ones((2, 6)))},
            save_at=[0.4 * k, 0.7 * k],
        )

    with compilations() as first:
        solve(1.0, None)
    with compilations() as others:
        solve(2.0, 0.01)
        solve(3.0, None)
    assert first
    assert not others


def test_single_precision_stays_single() -> None:
    x0 = {"g": start()["g"].astype(np.float32), "s": np.float32(0.3)}

    def solve(x0: dict[str, jax.Array]) -> tx.Solution:
        return tx.integrate(turning(), x0, t1=2.0, rtol=1e-5, atol=1e-5, save_at=np.array([0.0, 0.333, 1.0]))

    sol = solve(x0)
    assert {value.dtype for value in (*sol.xs.values(), sol.ts)} == {jnp.dtype("float32")}
    full = solve({name: value.astype(np.float64) for name, value in x0.items()})
    np.testing.assert_allclose(sol.xs["g"], full.xs["g"], atol=1e-4)
    assert doubles(jax.make_jaxpr(solve)(x0).jaxpr) == set()


def test_as_tight_as_single_precision_allows() -> None:
    """Ten times round-off: still a solution, and not one of rejections."""
    x0 = {"g": start()["g"].astype(np.float32), "s": np.float32(0.3)}
    sol = tx.integrate(turning(), x0, t1=2.0, rtol=1.2e-6, atol=1.2e-6, save_at=[0.5, 1.0, 2.0])
    assert sol.result is tx.Result.SUCCESS
    assert sol.stats.rejected < 0.2 * sol.stats.accepted
