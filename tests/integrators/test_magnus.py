"""Magnus methods: their order on every group, what they refuse, and what they share with every other method."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from derivative_oracles import check_derivatives
from integrator_bodies import free_body, spatial_inertia, start
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from test_charts import by_another_name, hat

import twistax as tx
from twistax.groups import Group, SpecialEuclidean, SpecialOrthogonal
from twistax.integrators import VectorField
from twistax.scalar import small_call as module
from twistax.tableaus import DOP853, RK4

ANGULAR = tx.SE3.with_order(tx.ANGULAR_FIRST)
GROUPS = [tx.SO3, tx.SE3, ANGULAR]
PHASES = np.array([0.0, 0.7, 1.9, 4.0])
FEWEST = {4: 20, 6: 10}
END = 2.0

Twist = Callable[[float, np.ndarray], np.ndarray]


def swapped(group: Group, twist: np.ndarray) -> np.ndarray:
    """The twist [v; w], or (w,), in the order of the group."""
    return np.roll(twist, 3) if group == ANGULAR else twist


def prescribed(t: float, phase: float, size: int) -> np.ndarray:
    """[v; w] or w: velocities that turn, so that they do not commute with those a moment later."""
    w = np.array([1.5 * np.sin(2.0 * t + phase), np.cos(3.0 * t - phase), 0.8 * t - 0.4])
    v = np.array([np.cos(t + phase), 0.5 * t * t, np.sin(4.0 * t)])
    return w if size == 3 else np.concatenate([v, w])


def moving(group: Group) -> tx.Dynamics:
    """The same as an expression."""
    g, t, phase = tx.State("g", group=group), tx.Time(), tx.Parameter("phase", value=0.3)
    w = tx.Concat(1.5 * tx.Sin(2.0 * t + phase), tx.Cos(3.0 * t - phase), 0.8 * t - 0.4)
    v = tx.Concat(tx.Cos(t + phase), 0.5 * t * t, tx.Sin(4.0 * t))
    rate = w if group == tx.SO3 else tx.lie.twist(linear=v, angular=w, order=group.order)
    return tx.compile(tx.System(rates={g: rate}))


def integrated(group: Group, g: np.ndarray, velocity: Callable[[float], np.ndarray], t1: float) -> np.ndarray:
    """g' = g hat(velocity) by SciPy on matrices."""

    def rate(t: float, y: np.ndarray) -> np.ndarray:
        return (y.reshape(g.shape) @ hat(group, velocity(t))).ravel()

    return solve_ivp(rate, (0.0, t1), g.ravel(), method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1].reshape(g.shape)


@pytest.fixture(scope="module")
def references() -> dict[int, list[np.ndarray]]:
    """The ends of the prescribed motions, on SO(3) and on SE(3)."""
    return {
        group.dimension: [
            integrated(group, np.asarray(group.identity()), lambda t, p=p, n=group.dimension: prescribed(t, p, n), END)
            for p in PHASES
        ]
        for group in (tx.SO3, tx.SE3)
    }


def slope(counts: np.ndarray, ends: Callable[[int], np.ndarray], wanted: np.ndarray) -> float:
    """Minus the slope of log error over log steps, the error being the root of its mean square over all starts."""
    errors = [np.sqrt(np.mean((ends(int(count)) - wanted) ** 2)) for count in counts]
    assert min(errors) > 1e-12
    return -np.polyfit(np.log(counts), np.log(errors), 1)[0]


def fitted_order(dynamics: tx.Dynamics, method: tx.Magnus, wanted: list[np.ndarray]) -> float:
    start = {"g": np.eye(len(wanted[0]))}

    def ends(count: int) -> np.ndarray:
        solutions = [
            tx.integrate(dynamics, start, t1=END, steps=count, method=method, params={"phase": p}) for p in PHASES
        ]
        return np.stack([solution.xs["g"][0] for solution in solutions])

    return slope(FEWEST[method.order] * np.array([1.0, 1.4, 2.0, 2.6]), ends, np.stack(wanted))


@pytest.mark.parametrize("order", [4, 6])
@pytest.mark.parametrize("group", GROUPS, ids=lambda group: group.name)
def test_the_order_with_a_prescribed_twist(group: Group, order: int, references: dict[int, list[np.ndarray]]) -> None:
    assert fitted_order(moving(group), tx.Magnus(order), references[group.dimension]) == pytest.approx(order, abs=0.15)


@pytest.mark.parametrize("order", [4, 6])
@pytest.mark.parametrize("kind", [SpecialOrthogonal, SpecialEuclidean])
def test_the_fit_sees_the_sign_of_the_brackets(
    kind: type[Group], order: int, references: dict[int, list[np.ndarray]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the brackets of Y' = A Y every order falls to two."""
    bracket = kind.bracket
    monkeypatch.setattr(kind, "bracket", lambda self, a, b: -bracket(self, a, b))
    group = kind()
    assert fitted_order(moving(group), tx.Magnus(order), references[group.dimension]) < 2.2


@pytest.mark.parametrize(("order", "twists"), [(4, tx.ANGULAR_FIRST), (6, tx.LINEAR_FIRST)])
def test_the_order_on_a_free_body(order: int, twists: tx.Order) -> None:
    """The velocity is a state without a group, brought to the nodes by an explicit method."""
    M = spatial_inertia()
    dynamics = tx.compile(free_body(twists))
    group, x = tx.SE3.with_order(twists), start()

    def rate(t: float, y: np.ndarray) -> np.ndarray:
        v, w = y[16:19], y[19:]
        p = M @ y[16:]
        force = -np.concatenate([np.cross(w, p[:3]), np.cross(v, p[:3]) + np.cross(w, p[3:])])
        return np.concatenate([(y[:16].reshape(4, 4) @ hat(tx.SE3, y[16:])).ravel(), np.linalg.solve(M, force)])

    y0 = np.concatenate([x["g"].ravel(), x["V"]])
    end = solve_ivp(rate, (0.0, 1.0), y0, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    wanted = np.concatenate([end[:16], swapped(group, end[16:])])

    def ends(count: int) -> np.ndarray:
        begin = x | {"V": swapped(group, x["V"])}
        xs = tx.integrate(dynamics, begin, t1=1.0, steps=count, method=tx.Magnus(order)).xs
        return np.concatenate([xs["g"].ravel(), xs["V"].ravel()])

    assert slope(np.array([10, 13, 16, 20]), ends, wanted) == pytest.approx(order, abs=0.15)


@pytest.mark.parametrize("order", [4, 6])
@pytest.mark.parametrize("group", GROUPS, ids=lambda group: group.name)
def test_a_constant_twist_is_exact_in_one_step(group: Group, order: int) -> None:
    rate, g = np.linspace(-1.0, 1.2, group.dimension), tx.State("g", group=group)
    dynamics = tx.compile(tx.System(rates={g: rate}))
    sol = tx.integrate(dynamics, {"g": group.identity()}, t1=3.0, steps=1, method=tx.Magnus(order))
    np.testing.assert_allclose(sol.xs["g"][0], expm(3.0 * hat(group, rate)), atol=2e-14)


@pytest.mark.slow
def test_methods_agree_on_fine_steps() -> None:
    methods = [tx.Magnus(), tx.Magnus(6), tx.CommutatorFree(), tx.RKMK(DOP853)]
    ends = [
        tx.integrate(moving(tx.SE3), {"g": np.eye(4)}, t1=1.0, steps=400, method=method).xs["g"] for method in methods
    ]
    for end in ends[1:]:
        np.testing.assert_allclose(end, ends[0], atol=1e-11)


def test_states_beside_the_poses() -> None:
    """States that no pose needs solve in one step of the inner method; controls are read at the nodes."""
    R, y, rate = tx.State("R", group=tx.SO3), tx.State("y", shape=(2, 2)), tx.Control("rate", shape=(3,))
    dynamics = tx.compile(tx.System(rates={R: rate, y: -y}))
    begin = {"R": np.eye(3), "y": np.arange(4.0).reshape(2, 2)}

    def rates(t: jax.Array) -> dict[str, jax.Array]:
        return {"rate": jnp.stack([jnp.sin(t), jnp.cos(2.0 * t), 0.3 * t])}

    for method, tolerance in ((tx.Magnus(), 1e-6), (tx.Magnus(6), 1e-9)):
        sol = tx.integrate(dynamics, begin, t1=1.0, dt=0.05, method=method, u=rates, save_at=[0.0, 0.33, 1.0])
        fine = tx.integrate(dynamics, begin, t1=1.0, dt=0.01, method=tx.RKMK(DOP853), u=rates, save_at=sol.ts)
        np.testing.assert_allclose(sol.xs["y"][:, 1, 1], 3.0 * np.exp(-np.asarray(sol.ts)), rtol=tolerance)
        np.testing.assert_allclose(sol.xs["R"], fine.xs["R"], atol=tolerance)


def test_a_rate_that_reads_a_pose_is_refused_by_name() -> None:
    g, h, V = tx.State("g", group=tx.SE3), tx.State("h", group=tx.SO3), tx.State("V", shape=(6,))
    fall = tx.Concat(g[:3, :3].T @ np.array([0.0, 0.0, -9.81]), np.zeros(3))
    heavy = tx.compile(tx.System(rates={g: V, V: fall}))
    message = r"Magnus 4 needs rates that do not .* but the rate of 'V' reads 'g'\.\n  fix: use tx\.RKMK"
    with pytest.raises(tx.ModelError, match=message):
        tx.integrate(heavy, {"g": np.eye(4), "V": np.zeros(6)}, t1=1.0, dt=0.1, method=tx.Magnus())
    following = tx.compile(tx.System(rates={g: tx.Concat(np.zeros(3), tx.lie.SO3Log(h)), h: np.ones(3)}))
    with pytest.raises(tx.ModelError, match="the rate of 'g' reads 'h'"):
        tx.Magnus(6).check(following)
    # A pose that cancels, or comes with a coefficient baked to zero, is not read.
    k = tx.Parameter("k", value=1.0)
    dragged = tx.System(rates={g: V, V: k * fall})
    tx.Magnus().check(tx.compile(dragged, bake={"k": 0.0}))
    with pytest.raises(tx.ModelError, match="the rate of 'V' reads 'g'"):
        tx.Magnus().check(tx.compile(dragged))


def test_a_group_of_your_own_works() -> None:
    """Its brackets come from its ad."""
    w = tx.Concat(tx.Sin(tx.Time()), tx.Cos(2.0 * tx.Time()), 0.5)

    def solve(group: Group) -> np.ndarray:
        dynamics = tx.compile(tx.System(rates={tx.State("R", group=group): w}))
        return tx.integrate(dynamics, {"R": np.eye(3)}, t1=1.0, dt=0.1, method=tx.Magnus(6)).xs["R"][0]

    np.testing.assert_allclose(solve(by_another_name()), solve(tx.SO3), atol=1e-14)


@pytest.mark.parametrize("order", [4, 6])
def test_the_increment_is_the_step(order: int) -> None:
    g, V = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,))
    dynamics = tx.compile(tx.System(rates={g: V, V: tx.Time() - np.arange(6.0) * V}))
    inputs = dynamics.functions.prepare(0.3, start())
    field = VectorField(dynamics, lambda t: {}, dict(inputs.params))
    arguments = (field, inputs.t, dict(inputs.x), jnp.asarray(0.1))
    method = tx.Magnus(order)
    eta, end = jax.jit(lambda: (method.increment(*arguments), method.step(*arguments)))()
    there = dynamics.group.retract(inputs.x, jnp.concatenate([eta[name] for name in dynamics.group.factors]))
    for name in end:
        np.testing.assert_allclose(there[name], end[name], atol=1e-14)


def test_solutions_are_one_small_function(monkeypatch: pytest.MonkeyPatch) -> None:
    body = tx.compile(free_body(), bake={"M": spatial_inertia()})
    known, seen = module.known_inside, []
    monkeypatch.setattr(module, "known_inside", lambda jaxpr: seen.append(known(jaxpr)) or seen[-1])
    for dynamics, x, order in ((body, start(), 6), (moving(ANGULAR), {"g": np.eye(4)}, 4)):
        by_xla = tx.Dynamics(dynamics.functions.run_by(tx.XLA()))
        sol = tx.integrate(by_xla, x, t1=1.0, dt=0.05, method=tx.Magnus(order))
        assert float(tx.SE3.defect(sol.xs["g"][0])) < 1e-14
    assert seen
    assert all(seen)


@pytest.mark.parametrize("order", [4, 6])
def test_precision_follows_the_start(order: int) -> None:
    R, w = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,))
    dynamics = tx.compile(tx.System(rates={R: w, w: -w}))
    starts = [{"R": np.eye(3, dtype=kind), "w": np.array([1.0, -2.0, 0.5], kind)} for kind in (np.float32, np.float64)]
    single, double = (tx.integrate(dynamics, x, t1=0.5, dt=0.05, method=tx.Magnus(order)).xs for x in starts)
    for name in single:
        assert single[name].dtype == np.float32
        np.testing.assert_allclose(single[name], double[name].astype(np.float32), atol=1e-6)


@pytest.mark.slow
def test_derivatives_agree() -> None:
    """Of one step by start and parameter. Loops over steps are the same for every method."""
    R, w, J = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,)), tx.Parameter("J", shape=(3,))
    spin = tx.compile(tx.System(rates={R: w, w: tx.linalg.Cross(J * w, w) / J}))

    def cost(z: jax.Array) -> jax.Array:
        x, params = {"R": jnp.eye(3), "w": z[:3]}, {"J": 2.0 + jnp.sin(z[3:])}
        end = tx.Magnus().step(VectorField(spin, lambda t: {}, params), jnp.asarray(0.0), x, jnp.asarray(0.3))
        return jnp.sum(end["R"] * jnp.cos(jnp.arange(9.0)).reshape(3, 3)) + jnp.sum(end["w"] ** 2)

    check_derivatives(cost, 6)


def test_evaluations_are_counted() -> None:
    """Nodes alone, nodes beside one step of the inner method, or one such step for each part between nodes."""
    R, w, y = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,)), tx.State("y")
    alone = tx.compile(tx.System(rates={R: np.ones(3)}))
    beside = tx.compile(tx.System(rates={R: np.ones(3), y: -y}))
    fed = tx.compile(tx.System(rates={R: w, w: -w}))
    counts = [[tx.Magnus(order).evaluations_of(dynamics) for dynamics in (alone, beside, fed)] for order in (4, 6)]
    assert counts == [[2, 6, 12], [3, 15, 48]]
    sol = tx.integrate(fed, {"R": np.eye(3), "w": np.ones(3)}, t1=1.0, steps=5, method=tx.Magnus())
    assert sol.stats.rhs_evaluations == 60


def test_methods_are_values() -> None:
    assert tx.Magnus() == tx.Magnus(4, RK4)
    assert tx.Magnus(6) != tx.Magnus(4)
    assert hash(tx.Magnus(6)) == hash(tx.Magnus(6, DOP853))
