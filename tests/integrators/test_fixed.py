"""Solutions against physics: momentum, both twist orders, other groups, several bodies, long runs."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from integrator_bodies import CENTRE, MASS, free_body, spatial_inertia, start
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import twistax as tx
from twistax.groups import so3
from twistax.integrators import VectorField
from twistax.tableaus import RK4


def world_momentum(pose: np.ndarray, V: np.ndarray) -> np.ndarray:
    """Linear and angular momentum in the world about its origin, from the motion of the centre of mass."""
    R, p = pose[..., :3, :3], pose[..., :3, 3]
    body = np.einsum("ij,...j->...i", spatial_inertia(), V)
    linear = np.einsum("...ij,...j->...i", R, body[..., :3])
    return np.concatenate([linear, np.einsum("...ij,...j->...i", R, body[..., 3:]) + np.cross(p, linear)], axis=-1)


def test_world_momentum_of_a_free_body_stays() -> None:
    ts = np.linspace(0.0, 5.0, 51)
    sol = tx.integrate(tx.compile(free_body()), start(), t1=5.0, dt=1e-3, save_at=ts)
    pose = np.asarray(sol.xs["g"])
    momentum = world_momentum(pose, np.asarray(sol.xs["V"]))
    assert np.linalg.norm(momentum[0, :3]) > 1.0
    assert np.abs(momentum - momentum[0]).max() < 1e-9
    centre = pose[:, :3, :3] @ CENTRE + pose[:, :3, 3]
    straight = centre[0] + momentum[0, :3] / MASS * ts[:, None]
    assert np.abs(centre - straight).max() < 1e-9


def test_both_twist_orders_fly_the_same() -> None:
    swap = [3, 4, 5, 0, 1, 2]
    linear_first = tx.integrate(tx.compile(free_body()), start(), t1=1.0, dt=1e-2).xs
    turned = start() | {"V": start()["V"][swap]}
    angular_first = tx.integrate(tx.compile(free_body(tx.ANGULAR_FIRST)), turned, t1=1.0, dt=1e-2).xs
    np.testing.assert_allclose(linear_first["g"], angular_first["g"], atol=1e-13)
    np.testing.assert_allclose(linear_first["V"], angular_first["V"][:, swap], atol=1e-13)


def test_a_top_a_matrix_and_a_scalar_fly_together() -> None:
    """SO(3), a matrix state and a scalar, coupled, against SciPy."""
    R, w = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,))
    P, s = tx.State("P", shape=(2, 3)), tx.State("s")
    inertia = np.array([1.0, 2.0, 3.0])
    mixing = np.array([[0.1, -0.4], [0.3, 0.2]])
    dynamics = tx.compile(
        tx.System(
            rates={
                s: -0.5 * s + w[0],
                R: w,
                w: (tx.linalg.Cross(inertia * w, w) + R[2, :] * s) / inertia,
                P: tx.Constant(mixing) @ P + P @ R,
            }
        )
    )
    x0 = {
        "R": np.asarray(so3.exp([0.3, -0.5, 0.8])),
        "w": np.array([0.5, 2.0, -1.0]),
        "P": np.arange(6.0).reshape(2, 3),
        "s": 0.7,
    }

    def rate(t: float, y: np.ndarray) -> np.ndarray:
        R, w, P, s = y[:9].reshape(3, 3), y[9:12], y[12:18].reshape(2, 3), y[18]
        W = np.asarray(so3.hat(w))
        slope = (np.cross(inertia * w, w) + R[2] * s) / inertia
        return np.concatenate([(R @ W).ravel(), slope, (mixing @ P + P @ R).ravel(), [-0.5 * s + w[0]]])

    y0 = np.concatenate([np.ravel(x0[name]) for name in ("R", "w", "P", "s")])
    y = solve_ivp(rate, (0.0, 2.0), y0, method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    end = tx.integrate(dynamics, x0, t1=2.0, dt=2e-3).xs
    assert {name: value.shape for name, value in end.items()} == {
        "s": (1,),
        "R": (1, 3, 3),
        "w": (1, 3),
        "P": (1, 2, 3),
    }
    np.testing.assert_allclose(np.concatenate([np.ravel(end[n]) for n in ("R", "w", "P", "s")]), y, atol=1e-9)


def test_two_bodies_joined_by_a_spring_keep_their_common_momentum() -> None:
    bodies = {name: (tx.State(f"g{name}", group=tx.SE3), tx.State(f"V{name}", shape=(6,))) for name in "ab"}
    (ga, Va), (gb, Vb) = bodies["a"], bodies["b"]
    pull = 5.0 * (gb[:3, 3] - ga[:3, 3])
    rates = {}
    for (g, V), force in (((ga, Va), pull), ((gb, Vb), -pull)):
        M = tx.Constant(spatial_inertia())
        F = tx.lie.wrench(force=g[:3, :3].T @ force, torque=np.zeros(3))
        rates |= {g: V, V: tx.linalg.Solve(M, F - tx.lie.AdjointDual(V, M @ V))}
    x0 = {f"{n}{name}": value for name, seed in (("a", 3), ("b", 5)) for n, value in start(seed).items()}
    x0["gb"] = x0["gb"] + np.eye(4, k=3) * 2.0
    sol = tx.integrate(tx.compile(tx.System(rates)), x0, t1=2.0, dt=1e-3, save_at=[0.0, 1.0, 2.0]).xs
    total = sum(world_momentum(np.asarray(sol[f"g{n}"]), np.asarray(sol[f"V{n}"])) for n in "ab")
    assert np.abs(sol["Va"][2] - sol["Va"][0]).max() > 0.1
    assert np.abs(total - total[0]).max() < 1e-9


def test_a_spatial_velocity_moves_the_body_about_the_world() -> None:
    """g' = xi_s^ g has the solution expm(t xi_s^) g_0 for a constant xi_s."""
    g, xi = tx.State("g", group=tx.SE3), tx.Parameter("xi", shape=(6,))
    dynamics = tx.compile(tx.System(rates={g: tx.lie.SE3Adjoint(tx.lie.Inverse(g)) @ xi}))
    twist = np.array([0.3, -1.0, 0.5, 0.7, 0.2, -0.9])
    end = tx.integrate(dynamics, {"g": start()["g"]}, t1=2.0, dt=1e-2, params={"xi": twist}).xs["g"][0]
    expected = expm(2.0 * np.asarray(tx.lie.se3.hat(twist))) @ start()["g"]
    np.testing.assert_allclose(end, expected, atol=1e-9)


def test_a_euclidean_step_is_a_plain_runge_kutta_step() -> None:
    x, y = tx.State("x", shape=(2,)), tx.State("y")
    dynamics = tx.compile(tx.System(rates={x: x * y, y: -y}))
    x0 = {"x": jnp.array([1.0, 2.0]), "y": jnp.array(0.5)}

    def eta(x0: dict[str, jax.Array]) -> dict[str, jax.Array]:
        return tx.RKMK(RK4).increment(VectorField(dynamics, lambda t: {}, {}), jnp.zeros(()), x0, jnp.asarray(0.1))

    written = str(jax.make_jaxpr(eta)(x0))
    assert not [name for name in ("sin", "cos", "sqrt", "div") if re.search(rf"= {name}\b", written)]

    def f(z: np.ndarray) -> np.ndarray:
        return np.array([z[0] * z[2], z[1] * z[2], -z[2]])

    z = np.array([1.0, 2.0, 0.5])
    k1 = f(z)
    k2 = f(z + 0.05 * k1)
    k3 = f(z + 0.05 * k2)
    k4 = f(z + 0.1 * k3)
    expected = 0.1 * (k1 + 2 * k2 + 2 * k3 + k4) / 6
    np.testing.assert_allclose(np.concatenate([eta(x0)["x"], eta(x0)["y"]]), expected, rtol=1e-14)


def test_a_million_steps_stay_in_the_group() -> None:
    """A constant twist is the worst case: without tightening the drift grows linearly, to 1e-10 here."""
    g, xi = tx.State("g", group=tx.SE3), tx.Parameter("xi", shape=(6,), value=[1.0, 0.2, -0.3, 0.8, -0.5, 0.4])
    dynamics = tx.compile(tx.System(rates={g: xi}))
    pose = tx.integrate(dynamics, {"g": np.eye(4)}, t1=1e4, dt=1e-2).xs["g"][0]
    assert float(tx.SE3.defect(pose)) < 1e-14


@pytest.mark.parametrize("size", [1e-3, 1e-6])
def test_tightening_squares_the_drift(size: float) -> None:
    drifted = start()["g"] @ (np.eye(4) + size * np.pad(np.random.default_rng(0).normal(size=(3, 3)), (0, 1)))
    before, after = float(tx.SE3.defect(drifted)), float(tx.SE3.defect(tx.SE3.tighten(drifted)))
    assert before > size
    assert after < 3.0 * before**2 + 1e-15
    np.testing.assert_allclose(tx.SE3.tighten(drifted), tx.SE3.normalize(drifted), atol=30 * size**2 + 1e-15)
    assert float(tx.SO3.defect(tx.SO3.tighten(drifted[:3, :3]))) == after
