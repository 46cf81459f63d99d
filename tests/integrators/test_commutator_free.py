"""Commutator-free methods: their order, their data, and what they share with every other method."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from derivative_oracles import check_derivatives
from integrator_bodies import forced, forced_body, forced_body_reference, spatial_inertia, start
from scipy.linalg import expm
from test_charts import by_another_name, hat
from test_order import END, STARTS, fitted_order

import twistax as tx
from twistax.groups import Group
from twistax.integrators import Method, VectorField
from twistax.scalar import small_call as module
from twistax.tableaus import CF4, RK4, CommutatorFreeTableau

CF = tx.CommutatorFree()


@pytest.fixture(scope="module")
def references() -> list[dict[str, np.ndarray]]:
    return [forced_body_reference(x, END) for x in STARTS]


def test_the_order_is_four(references: list[dict[str, np.ndarray]]) -> None:
    assert fitted_order(forced(), CF, references) == pytest.approx(4.0, abs=0.15)


def test_the_fit_sees_the_order_of_the_exponentials(references: list[dict[str, np.ndarray]]) -> None:
    """Papers write right-trivialised equations, where what acts first stands on the right."""
    step = CommutatorFreeTableau("reversed", 4, CF4.a, CF4.b[::-1])
    stage = CommutatorFreeTableau("last stage reversed", 4, [*CF4.a[:3], CF4.a[3][::-1]], CF4.b)
    assert fitted_order(forced(), tx.CommutatorFree(step), references) < 2.2
    assert fitted_order(forced(), tx.CommutatorFree(stage), references) < 3.2


def test_another_method_is_data_only(references: list[dict[str, np.ndarray]]) -> None:
    """The three-stage Crouch-Grossman method of order 3: one slope in every exponential."""
    b, last = (13 / 51, -2 / 3, 24 / 17), (119 / 216, 17 / 108)
    steps = [[0.0] * i + [weight] for i, weight in enumerate(b)]
    third = CommutatorFreeTableau("Crouch-Grossman 3", 3, [[], [[3 / 4]], [[last[0]], [0.0, last[1]]]], steps)
    np.testing.assert_allclose(third.c, [0.0, 3 / 4, 17 / 24], rtol=1e-15)
    assert fitted_order(forced(), tx.CommutatorFree(third), references) == pytest.approx(3.0, abs=0.15)


def test_without_a_group_it_is_the_classical_method() -> None:
    x, A = tx.State("x", shape=(3, 2)), np.array([[0.0, 1.0, 0.2], [-1.0, 0.0, 0.3], [0.1, -0.4, -0.5]])
    linear = tx.compile(tx.System(rates={x: A @ x + tx.Sin(tx.Time())}))
    for field in ("a", "b", "c"):
        np.testing.assert_allclose(getattr(CF4.underlying, field), getattr(RK4, field), atol=1e-16)
    integrated = [
        tx.integrate(linear, {"x": np.arange(6.0).reshape(3, 2)}, t1=2.0, dt=0.1, method=m).xs["x"]
        for m in (CF, tx.RKMK(RK4))
    ]
    np.testing.assert_allclose(*integrated, rtol=1e-14, atol=1e-14)


@pytest.mark.parametrize("group", [tx.SO3, tx.SE3, tx.SE3.with_order(tx.ANGULAR_FIRST)], ids=lambda group: group.name)
def test_a_constant_twist_is_exact_in_one_step(group: Group) -> None:
    rate = np.linspace(-1.0, 1.2, group.dimension)
    g = tx.State("g", group=group)
    sol = tx.integrate(tx.compile(tx.System(rates={g: rate})), {"g": group.identity()}, t1=1.5, steps=1, method=CF)
    np.testing.assert_allclose(sol.xs["g"][0], expm(1.5 * hat(group, rate)), atol=2e-14)
    assert sol.stats.rhs_evaluations == 4


def test_a_group_of_your_own_works() -> None:
    def solve(group: Group, method: Method) -> np.ndarray:
        R, w, J = tx.State("R", group=group), tx.State("w", shape=(3,)), np.array([1.0, 2.0, 3.0])
        spin = tx.compile(tx.System(rates={R: w, w: tx.linalg.Cross(J * w, w) / J + R.T @ np.array([0.0, 0.1, 0.3])}))
        return tx.integrate(spin, {"R": np.eye(3), "w": J}, t1=1.0, dt=0.005, method=method).xs["R"][0]

    np.testing.assert_allclose(solve(by_another_name(), CF), solve(tx.SO3, CF), atol=1e-13)
    np.testing.assert_allclose(solve(tx.SO3, CF), solve(tx.SO3, tx.RKMK(RK4)), atol=1e-9)


def test_solutions_are_one_small_function(monkeypatch: pytest.MonkeyPatch) -> None:
    body = tx.compile(forced_body(), bake={"M": spatial_inertia()}, backend=tx.XLA())
    known, seen = module.known_inside, []
    monkeypatch.setattr(module, "known_inside", lambda jaxpr: seen.append(known(jaxpr)) or seen[-1])
    sol = tx.integrate(body, start(), t1=1.0, dt=0.05, method=CF, save_at=[0.0, 0.32, 1.0])
    assert seen
    assert all(seen)
    fine = tx.integrate(body, start(), t1=1.0, dt=0.003, method=CF, save_at=[0.0, 0.32, 1.0])
    np.testing.assert_allclose(sol.xs["g"], fine.xs["g"], atol=1e-4)
    assert float(jnp.max(jax.vmap(tx.SE3.defect)(sol.xs["g"][1:]))) < 1e-14


def test_precision_follows_the_start() -> None:
    R, w, J = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,)), np.array([1.0, 2.0, 3.0])
    spin = tx.compile(tx.System(rates={R: w, w: tx.linalg.Cross(J * w, w) / J}))
    starts = [{"R": np.eye(3, dtype=kind), "w": np.array([1.0, -2.0, 0.5], kind)} for kind in (np.float32, np.float64)]
    single, double = (tx.integrate(spin, x, t1=0.5, dt=0.02, method=CF).xs for x in starts)
    for name in single:
        assert single[name].dtype == np.float32
        np.testing.assert_allclose(single[name], double[name].astype(np.float32), atol=1e-5)


def test_derivatives_agree() -> None:
    """Of one step, where some exponents are zero, by two controls. Loops over steps are the same for every method."""
    R, w, T = tx.State("R", group=tx.SO3), tx.Control("w", shape=(3,)), tx.Control("T", shape=(3,))
    spin = tx.compile(tx.System(rates={R: w + R.T @ T}))

    def cost(z: jax.Array) -> jax.Array:
        u = {"w": z[:3], "T": z[3:]}
        end = CF.step(VectorField(spin, lambda t: u, {}), jnp.asarray(0.0), {"R": jnp.eye(3)}, jnp.asarray(0.3))
        return jnp.sum(end["R"] * jnp.cos(jnp.arange(9.0)).reshape(3, 3))

    check_derivatives(cost, 6)


def test_more_than_half_a_turn_is_a_failure() -> None:
    R = tx.State("R", group=tx.SO3)
    spin = tx.compile(tx.System(rates={R: np.array([0.0, 0.0, 8.0])}))
    with pytest.raises(tx.IntegrationError, match="'R' became infinite or NaN"):
        tx.integrate(spin, {"R": np.eye(3)}, t1=1.0, steps=1, method=CF)


def test_a_step_has_no_tangent_and_says_so() -> None:
    inputs = forced().functions.prepare(0.0, start())
    field = VectorField(forced(), lambda t: {}, dict(inputs.params))
    with pytest.raises(tx.ModelError, match="CF4 does not provide the tangent of its step"):
        CF.increment(field, inputs.t, dict(inputs.x), jnp.asarray(0.1))


def test_methods_are_values() -> None:
    assert tx.CommutatorFree(CF4) == CF
    assert hash(tx.CommutatorFree(CF4)) == hash(CF)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("a", "b", "message"),
    [
        ([[], [[1.0]]], [[0.5, 0.4]], r"tableau 'bad': b must sum to 1, but it sums to 0\.9"),
        (
            [[], [[0.5, 0.5]]],
            [[1.0]],
            r"a\[1\] has 2 weights, but only 1 earlier slopes exist: the method would be implicit",
        ),
        ([[], [[0.0]]], [[1.0]], r"a\[1\] has an exponential whose weights are all zero"),
        ([[], [[1.0]]], [[0.5, 0.25, 0.25]], "b has 3 weights, but only 2 earlier slopes exist"),
        ([[], [1.0]], [[1.0]], r"a\[1\] is not a list of rows of numbers"),
        ([[], [[float("nan")]]], [[1.0]], "a has entries that are not finite"),
    ],
)
def test_bad_data_is_named(a: object, b: object, message: str) -> None:
    with pytest.raises(tx.ModelError, match=message):
        CommutatorFreeTableau("bad", 2, a, b)
