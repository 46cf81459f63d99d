"""Splitting methods: order on bodies in a potential, exactness, what stays, and what they share with other methods."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from derivative_oracles import check_derivatives
from integrator_bodies import CENTRE, MASS, spatial_inertia, start
from scipy.linalg import expm
from splitting_bodies import (
    HUNG_BODY,
    SWAP,
    TENSOR,
    TOP_BODY,
    TOP_START,
    compiled_hung,
    compiled_top,
    hung,
    hung_reference,
    top,
    top_reference,
)

import twistax as tx
from oracles import skew
from twistax.compositions import ALL, KAHAN_LI6, KAHAN_LI8, STRANG, SUZUKI4
from twistax.integrators import VectorField
from twistax.scalar import small_call as module
from twistax.scenes import SCENES, free_rotation, offset_tumble

END = 3.0
COUNTS = {STRANG: (100, 200), SUZUKI4: (30, 60), KAHAN_LI6: (20, 40), KAHAN_LI8: (14, 28)}

#: Principal moments, kg m2.
MOMENTS = np.array([1.0, 1.4, 0.6])

State = dict[str, np.ndarray]


@pytest.fixture(scope="module")
def top_end() -> State:
    return top_reference(TOP_START, END)


@pytest.fixture(scope="module")
def hung_end() -> State:
    return hung_reference(start(), END)


def distance(sol: tx.Solution, wanted: State) -> float:
    return max(float(np.abs(np.asarray(sol.xs[name][-1]) - value).max()) for name, value in wanted.items())


def fitted(dynamics: tx.Dynamics, x0: State, wanted: State, method: tx.Splitting) -> float:
    counts = COUNTS[method.composition]
    errors = [distance(tx.integrate(dynamics, x0, t1=END, steps=n, method=method), wanted) for n in counts]
    assert 1e-11 < errors[-1] < 2e-3
    return float(np.log2(errors[0] / errors[1]))


@pytest.mark.parametrize("composition", ALL, ids=lambda c: c.name)
def test_order_of_an_asymmetric_top_in_a_field_that_changes(
    composition: tx.compositions.Composition, top_end: State
) -> None:
    order = fitted(compiled_top(), TOP_START, top_end, tx.Splitting(composition, TOP_BODY))
    assert abs(order - composition.order) < 0.25


@pytest.mark.parametrize(
    "composition", [pytest.param(c, marks=[pytest.mark.slow] if c.order > 4 else []) for c in ALL], ids=lambda c: c.name
)
def test_order_of_a_body_with_offset_centre_of_mass_on_a_spring(
    composition: tx.compositions.Composition, hung_end: State
) -> None:
    order = fitted(compiled_hung(), start(), hung_end, tx.Splitting(composition, HUNG_BODY))
    assert abs(order - composition.order) < 0.25


def variants() -> dict[str, Any]:
    """Name -> system, body, start and end as functions of those with a velocity and [v; w]."""
    M = spatial_inertia()
    swapped, angular = M[np.ix_(SWAP, SWAP)], tx.ANGULAR_FIRST
    of_a_point = spatial_inertia(1.0, CENTRE, np.zeros((3, 3)))
    built = tx.Parameter("m", value=MASS) * of_a_point + (M - MASS * of_a_point)
    return {
        "angular first": (hung(angular), tx.FreeBody("g", "V", inertia=swapped), lambda x: x | {"V": x["V"][SWAP]}),
        "momentum": (
            hung(momentum=True),
            tx.FreeBody("g", momentum="mu", inertia=M),
            lambda x: {"g": x["g"], "mu": M @ x["V"]},
        ),
        "momentum, angular first": (
            hung(angular, momentum=True),
            tx.FreeBody("g", momentum="mu", inertia=swapped),
            lambda x: {"g": x["g"], "mu": (M @ x["V"])[SWAP]},
        ),
        "an expression": (hung(matrix=built), tx.FreeBody("g", "V", inertia=built), lambda x: x),
    }


#: The others cover these; they take as long to compile.
_SLOW = ("angular first", "momentum", "an expression")


@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.slow] if n in _SLOW else []) for n in variants()])
def test_variants_fly_the_same_body(name: str, hung_end: State) -> None:
    system, body, of = variants()[name]
    method = tx.Splitting(KAHAN_LI8, [body])
    sol = tx.integrate(tx.compile(system), of(start()), t1=END, steps=80, method=method)
    assert distance(sol, of(hung_end)) < 2e-10


@pytest.mark.slow
def test_a_spatial_inertia_that_is_a_parameter(hung_end: State) -> None:
    """A matrix that is none ends the solution: nothing can be raised inside of a compiled one."""
    M = tx.Parameter("M", value=spatial_inertia())
    dynamics, method = tx.compile(hung(matrix=M)), tx.Splitting(KAHAN_LI8, tx.FreeBody("g", "V", inertia=M))
    sol = tx.integrate(dynamics, start(), t1=END, steps=80, method=method)
    assert distance(sol, hung_end) < 2e-10
    wrong = {"M": np.diag([1.0, 2.0, 3.0, 1.0, 1.0, 1.0])}
    sol = tx.integrate(dynamics, start(), t1=END, steps=80, method=method, params=wrong, throw=False)
    assert sol.result == tx.Result.NON_FINITE
    assert sol.stats.accepted == 0


def test_inertia_given_at_run_time(top_end: State) -> None:
    """The tensor integrated is none that was known when the free motion was split, and has other axes."""
    R, w, J = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,)), tx.Parameter("J", shape=(3, 3))
    fixed = top()
    rate = fixed.rates["w"]
    assert isinstance(rate, tx.linalg.Solve)
    dynamics = tx.compile(
        tx.System(
            rates={R: w, w: tx.linalg.Solve(J, rate.b - tx.linalg.Cross(TENSOR @ w, w) + tx.linalg.Cross(J @ w, w))}
        )
    )
    method = tx.Splitting(KAHAN_LI8, tx.FreeBody(R, w, inertia="J"))
    sol = tx.integrate(dynamics, TOP_START, t1=END, steps=80, method=method, params={"J": TENSOR})
    assert distance(sol, top_end) < 2e-10


@pytest.mark.slow
def test_moments_given_at_run_time_are_those_of_a_constant() -> None:
    moments, J = MOMENTS, tx.Parameter("J", value=[1.1, 1.0, 0.5])
    R, w = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,))

    def system(inertia: Any) -> tx.Dynamics:
        torque = tx.linalg.Cross(np.array([0.3, -0.2, 1.5]), R.T @ np.array([0.0, 0.0, -2.0]))
        return tx.compile(tx.System(rates={R: w, w: (tx.linalg.Cross(inertia * w, w) + torque) / inertia}))

    free, fixed = system(J), system(moments)
    ends = [
        tx.integrate(dynamics, TOP_START, t1=END, steps=60, params=params, method=tx.Splitting(KAHAN_LI8, body))
        for dynamics, body, params in (
            (free, tx.FreeBody(R, w, inertia=J), {"J": moments}),
            (fixed, tx.FreeBody(R, w, inertia=moments), {}),
        )
    ]
    for name in ("R", "w"):
        np.testing.assert_allclose(ends[0].xs[name], ends[1].xs[name], atol=1e-9)


@pytest.mark.slow
def test_a_point_and_an_attitude_together() -> None:
    """A satellite under the gravity gradient: the torque reads the position, which moves as a particle."""
    scene = SCENES["low-orbit"]
    method = tx.Splitting(KAHAN_LI8, [tx.FreeBody("R", "w", inertia=(10.0, 20.0, 25.0)), tx.FreeParticle("p", "v")])
    sol = scene.integrate(steps=400, method=method)
    assert scene.error({name: value[-1] for name, value in sol.xs.items()}) < 1e-8


@pytest.mark.parametrize("name", [pytest.param("symmetric-body", marks=pytest.mark.slow), "fast-spin"])
def test_a_free_symmetric_body_is_exact_in_one_step(name: str) -> None:
    """The fast one turns by 1.5e4 rad in this step: a unit in the last place of its rate is 1e-12 rad."""
    scene = SCENES[name]
    sol = scene.integrate(steps=1, method=tx.Splitting(STRANG, tx.FreeBody("R", "w", inertia=(1.0, 1.0, 1.5))))
    assert scene.error({name: value[-1] for name, value in sol.xs.items()}) < (
        1e-13 if name == "symmetric-body" else 1e-11
    )


def test_a_free_sphere_is_exact_in_one_step() -> None:
    R, w = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,))
    dynamics = tx.compile(tx.System(rates={R: w, w: 0.0 * w}))
    sol = tx.integrate(
        dynamics, TOP_START, t1=7.0, steps=1, method=tx.Splitting(STRANG, tx.FreeBody(R, w, inertia=[2.0, 2.0, 2.0]))
    )
    np.testing.assert_allclose(sol.xs["R"][-1], TOP_START["R"] @ expm(7.0 * skew(TOP_START["w"])), atol=3e-15)


@pytest.mark.parametrize(
    "axis",
    [
        pytest.param(np.array([1.0, 0.0, 0.0]), id="x", marks=pytest.mark.slow),
        pytest.param(np.array([0.6, 0.0, 0.8]), id="tilted"),
    ],
)
def test_one_step_of_a_symmetric_body_with_offset_centre_of_mass(axis: np.ndarray) -> None:
    """The centre of mass goes straight ahead, and about it the body turns as the exact solution says."""
    own = np.asarray(tx.pose()[:3, :3])
    turn = np.asarray(
        tx.lie.so3.exp(np.cross([0.0, 0.0, 1.0], axis) / np.linalg.norm(np.cross([0, 0, 1], axis)) * np.arccos(axis[2]))
    )
    np.testing.assert_allclose(turn @ own[:, 2], axis, atol=1e-15)
    w0, R0, seconds = np.array([0.6, -0.4, 3.0]), start()["g"][:3, :3], 40.0
    R, w = free_rotation.SymmetricBody(1.0, 1.5, R0 @ turn, w0).at(seconds)
    R, w, w0 = R @ turn.T, turn @ w, turn @ w0
    M = spatial_inertia(inertia=turn @ np.diag([1.0, 1.0, 1.5]) @ turn.T)
    g, V = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,))
    dynamics = tx.compile(tx.System(rates={g: V, V: tx.linalg.Solve(M, -tx.lie.AdjointDual(V, M @ V))}))
    x0 = {"g": start()["g"], "V": np.append([0.3, -0.2, 0.5], w0)}
    sol = tx.integrate(dynamics, x0, t1=seconds, steps=1, method=tx.Splitting(STRANG, tx.FreeBody(g, V, inertia=M)))
    velocity = R0 @ (x0["V"][:3] + np.cross(w0, CENTRE))
    centre = x0["g"][:3, 3] + R0 @ CENTRE + seconds * velocity
    np.testing.assert_allclose(sol.xs["g"][-1, :3, :3], R, atol=1e-12)
    np.testing.assert_allclose(sol.xs["g"][-1, :3, 3], centre - R @ CENTRE, atol=1e-12)
    np.testing.assert_allclose(sol.xs["V"][-1], np.append(R.T @ velocity - np.cross(w, CENTRE), w), atol=1e-12)


def test_a_step_and_back() -> None:
    dynamics, method = compiled_top(), tx.Splitting(KAHAN_LI6, TOP_BODY)

    @jax.jit
    def step(t: Any, x: Any, h: Any) -> Any:
        return method.step(VectorField(dynamics, lambda t: {}, {}), t, x, h)

    moved = step(0.7, {name: jnp.asarray(value) for name, value in TOP_START.items()}, 0.3)
    back = step(1.0, moved, -0.3)
    for name, value in TOP_START.items():
        assert np.abs(moved[name] - value).max() > 0.05
        np.testing.assert_allclose(back[name], value, atol=3e-14)


def test_a_free_body_keeps_its_momenta_to_round_off() -> None:
    """1e4 steps, a centre of mass off the origin, three moments: momenta about the point where it started."""
    scene = SCENES["offset-tumble"]
    dynamics, M = scene.dynamics, spatial_inertia(offset_tumble.MASS, offset_tumble.CENTER, offset_tumble.INERTIA)
    method = tx.Splitting(SUZUKI4, tx.FreeBody("g", "V", inertia=M))
    x0 = dict(scene.start)
    sol = tx.integrate(dynamics, x0, t1=100.0, steps=10_000, method=method, save_at=np.linspace(0.0, 100.0, 11))

    def momenta(g: np.ndarray, V: np.ndarray) -> np.ndarray:
        p, L = np.split(M @ V, 2)
        about_start = g[:3, 3] - x0["g"][:3, 3]
        return np.concatenate([g[:3, :3] @ p, g[:3, :3] @ L + np.cross(about_start, g[:3, :3] @ p)])

    kept = np.array([momenta(np.asarray(g), np.asarray(V)) for g, V in zip(sol.xs["g"], sol.xs["V"], strict=True)])
    far = np.linalg.norm(np.asarray(sol.xs["g"])[:, :3, 3], axis=1).max()
    assert far > 50.0
    assert np.abs(kept[:, :3] - kept[0, :3]).max() < 3e-15 * np.linalg.norm(kept[0, :3])
    assert np.abs(kept[:, 3:] - kept[0, 3:]).max() < 1e-15 * far * np.linalg.norm(kept[0])


def test_energy_of_a_heavy_top_stays_in_bounds() -> None:
    """1e5 steps: no drift, in the energy or in the momenta. Energy swings by the error of a step."""
    scene = SCENES["heavy-top"]
    method = tx.Splitting(SUZUKI4, tx.FreeBody("R", "w", inertia=(1.0, 1.0, 0.5)))
    times = np.linspace(0.0, 1000.0, 401)
    sol = tx.integrate(scene.dynamics, scene.start, t1=1000.0, steps=100_000, method=method, save_at=times)
    found = jax.vmap(lambda R, w: scene.dynamics.outputs(0.0, {"R": R, "w": w}))(sol.xs["R"], sol.xs["w"])
    energy = np.abs(found["energy"] - found["energy"][0]) / np.abs(found["energy"][0])
    assert 1e-13 < energy[:200].max() < 1e-9
    assert energy[200:].max() < 1.5 * energy[:200].max()
    turned = np.asarray(sol.xs["R"])
    assert np.abs(np.swapaxes(turned, 1, 2) @ turned - np.eye(3)).max() < 2e-15
    for name in ("vertical_momentum", "axial_momentum"):
        assert np.abs(found[name] - found[name][0]).max() < 1e-11


def driven() -> tx.Dynamics:
    R, w, F = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,)), tx.Control("F", shape=(3,))
    return tx.compile(tx.System(rates={R: w, w: tx.linalg.Solve(TENSOR, tx.linalg.Cross(TENSOR @ w, w) + R.T @ F)}))


@pytest.mark.slow
def test_controls_that_jump_at_steps_cost_no_order() -> None:
    dynamics, rows = driven(), np.random.default_rng(4).normal(size=(4, 3))
    u = {"F": tx.ZeroOrderHold(ts=[0.0, 0.5, 1.0, 1.5], values=rows)}
    wanted = tx.integrate(dynamics, TOP_START, t1=2.0, rtol=1e-13, u=u, method=tx.RKMK(tx.tableaus.DOP853)).xs
    wanted = {name: np.asarray(value[-1]) for name, value in wanted.items()}
    method = tx.Splitting(KAHAN_LI6, TOP_BODY)
    errors = [
        distance(tx.integrate(dynamics, TOP_START, t1=2.0, steps=n, u=u, method=method), wanted) for n in (16, 32)
    ]
    assert 1e-10 < errors[1] < 1e-5
    assert np.log2(errors[0] / errors[1]) > 5.6


@pytest.mark.slow
def test_saved_times_and_dense_output(top_end: State) -> None:
    method = tx.Splitting(KAHAN_LI8, TOP_BODY)
    sol = tx.integrate(
        compiled_top(), TOP_START, t1=2.0 * END, steps=110, method=method, save_at=[0.0, END], dense=True
    )
    np.testing.assert_array_equal(sol.xs["w"][0], TOP_START["w"])
    for name, value in top_end.items():
        np.testing.assert_allclose(sol.xs[name][1], value, atol=1e-9)
        np.testing.assert_allclose(sol.evaluate(END)[name], value, atol=1e-9)
    assert sol.stats.rhs_evaluations == (110 + 0) * 17


def pushed() -> tuple[tx.Dynamics, tx.Splitting]:
    """A body whose moments are a parameter, and its method."""
    R, w, F = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,)), tx.Control("F", shape=(3,))
    J = tx.Parameter("J", value=MOMENTS)
    dynamics = tx.compile(tx.System(rates={R: w, w: (tx.linalg.Cross(J * w, w) + R.T @ F) / J}))
    return dynamics, tx.Splitting(SUZUKI4, tx.FreeBody(R, w, inertia=J))


def inputs(z: jax.Array) -> tuple[Any, Any, Any]:
    """A start, a control and moments from nine numbers."""
    return {"R": tx.lie.so3.exp(z[:3]), "w": z[3:6]}, {"F": z[6:]}, {"J": jnp.asarray(MOMENTS) + 0.1 * z[3:6]}


H = 0.2


@functools.cache
def stepped() -> Any:
    """Nine numbers and a direction -> the end of a step, R row by row and w, and its derivative along the direction."""
    dynamics, method = pushed()

    def end(z: jax.Array) -> jax.Array:
        x0, u, params = inputs(z)
        x = method.step(VectorField(dynamics, lambda t: u, params), jnp.asarray(0.0), x0, jnp.asarray(H))
        return jnp.concatenate([x["R"].reshape(-1), x["w"]])

    return jax.jit(lambda z, direction: jax.jvp(end, (z,), (direction,)))


@pytest.mark.slow
def test_derivatives_of_steps() -> None:
    """With respect to the start, the moments and a control; those in reverse are with the solutions."""
    rng, step = np.random.default_rng(2), 1e-5
    for z, direction in rng.normal(size=(2, 2, 9)):
        _, slope = stepped()(z, direction)
        ends = [stepped()(z + sign * step * direction, direction)[0] for sign in (1.0, -1.0)]
        np.testing.assert_allclose(slope, (ends[0] - ends[1]) / (2.0 * step), atol=1e-8)


def test_derivatives_at_rest() -> None:
    """No body turns and no force acts, so that all angles are zero: the angle after h is h w to first order."""
    w = np.array([0.3, -0.5, 0.7])
    _, slope = stepped()(np.zeros(9), np.concatenate([np.zeros(3), w, np.zeros(3)]))
    np.testing.assert_allclose(slope, np.append(H * skew(w), w), atol=1e-14)


@pytest.mark.slow
def test_derivatives_of_a_solution() -> None:
    dynamics, method = pushed()

    def cost(z: jax.Array) -> jax.Array:
        x0, u, params = inputs(z)
        sol = tx.integrate(dynamics, x0, t1=0.5, steps=5, u=u, params=params, method=method)
        return jnp.sum(sol.xs["w"][-1] ** 2) + sol.xs["R"][-1, 0, 1]

    check_derivatives(cost, 9)


def test_a_batch_is_integrated_as_each_alone() -> None:
    dynamics, method = compiled_hung(), tx.Splitting(KAHAN_LI6, HUNG_BODY)
    twists = np.random.default_rng(1).normal(size=(3, 6))

    def end(V: Any) -> Any:
        return tx.integrate(dynamics, {"g": start()["g"], "V": V}, t1=1.0, steps=20, method=method).xs["V"][-1]

    together = jax.jit(jax.vmap(end))(jnp.asarray(twists))
    np.testing.assert_allclose(together, [end(V) for V in twists], rtol=1e-12, atol=1e-13)


@pytest.mark.slow
def test_single_precision(hung_end: State) -> None:
    x0 = {name: np.asarray(value, np.float32) for name, value in start().items()}
    sol = tx.integrate(compiled_hung(), x0, t1=END, steps=60, method=tx.Splitting(KAHAN_LI6, HUNG_BODY))
    assert sol.xs["g"].dtype == sol.xs["V"].dtype == np.float32
    assert distance(sol, hung_end) < 1e-4


def test_the_loop_is_one_small_call() -> None:
    dynamics, method = compiled_hung(), tx.Splitting(KAHAN_LI6, HUNG_BODY)
    y = method.stored(dynamics, {}).enter({name: jnp.asarray(value) for name, value in start().items()})
    t = jnp.asarray(0.0)
    assert module.fits(lambda y, t, h: method.advance(VectorField(dynamics, lambda t: {}, {}), t, y, h), y, t, t)
