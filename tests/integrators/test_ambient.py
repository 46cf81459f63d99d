"""The same system as a plain ODE for diffrax."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from integrator_bodies import forced, start

import twistax as tx

TIMES = np.array([0.0, 0.4, 1.0])


def solve(term: tx.diffrax.AmbientTerm, x0: dict, args: object, **rest: object) -> dict:
    """Dopri8 at tight tolerance; states at TIMES."""
    sol = diffrax.diffeqsolve(
        term,
        diffrax.Dopri8(),
        0.0,
        1.0,
        0.01,
        term.to_ambient(x0),
        args=args,
        saveat=diffrax.SaveAt(ts=TIMES),
        stepsize_controller=diffrax.PIDController(rtol=1e-11, atol=1e-12),
    )
    return jax.vmap(term.from_ambient)(sol.ys)


@pytest.fixture(scope="module")
def solutions() -> dict[str, dict]:
    dynamics = forced()
    fixed = tx.integrate(dynamics, start(), t1=1.0, dt=1e-3, save_at=TIMES).xs
    both = {q: solve(tx.diffrax.ambient_term(dynamics, quaternion=q), start(), None) for q in (True, False)}
    return {"fixed": fixed, "quaternion": both[True], "matrix": both[False]}


@pytest.mark.parametrize("kind", ["quaternion", "matrix"])
def test_the_ambient_solution_is_the_solution_on_the_group(solutions: dict[str, dict], kind: str) -> None:
    for name in ("g", "V"):
        np.testing.assert_allclose(solutions[kind][name], solutions["fixed"][name], atol=1e-9)


def moved(dynamics: tx.Dynamics, term: tx.diffrax.AmbientTerm, x0: dict, velocity: np.ndarray) -> dict:
    """d/dh of the numbers of x0 (+) h velocity at 0: the rates by the chain rule through the group's exponential."""

    def numbers(h: jax.Array) -> dict:
        return term.to_ambient(dynamics.retract(x0, h * jnp.asarray(velocity)))

    return jax.jvp(numbers, (jnp.zeros(()),), (jnp.ones(()),))[1]


@pytest.mark.parametrize("quaternion", [True, False])
@pytest.mark.parametrize(
    ("group", "shapes"), [(tx.SE3, [(7,), (4, 4)]), (tx.SE3.with_order(tx.ANGULAR_FIRST), [(7,), (4, 4)])]
)
def test_poses_in_either_order(group: object, shapes: list, quaternion: bool) -> None:
    g, xi = tx.State("g", group=group), tx.Parameter("xi", shape=(6,))
    dynamics = tx.compile(tx.System(rates={g: xi}))
    x0, velocity = {"g": start()["g"]}, np.array([0.3, -1.0, 0.5, 0.7, 0.2, -0.9])
    term = tx.diffrax.ambient_term(dynamics, quaternion=quaternion)
    y0 = term.to_ambient(x0)
    assert y0["g"].shape == shapes[not quaternion]
    np.testing.assert_allclose(term.from_ambient(y0)["g"], x0["g"], atol=1e-14)
    rate = term.vf(0.0, y0, (None, {"xi": velocity}))
    np.testing.assert_allclose(rate["g"], moved(dynamics, term, x0, velocity)["g"], atol=1e-13)


def test_rotations_controls_and_parameters() -> None:
    """SO(3) in quaternions; u and params travel in args, in every form that integrate takes."""
    R, w, tau = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,)), tx.Control("tau", shape=(3,))
    J = tx.Parameter("J", shape=(3,), value=[1.0, 2.0, 3.0])
    dynamics = tx.compile(tx.System(rates={w: (tx.linalg.Cross(J * w, w) + tau) / J, R: w}))
    x0 = {"R": start()["g"][:3, :3], "w": np.array([0.5, 2.0, -1.0])}
    term = tx.diffrax.ambient_term(dynamics)
    y0 = term.to_ambient(x0)
    assert {name: value.shape for name, value in y0.items()} == {"w": (3,), "R": (4,)}
    table = tx.FirstOrderHold([0.0, 1.0], [[0.0, 1.0, 0.0], [2.0, 0.0, 0.0]])
    for u, now, params in (
        ({"tau": np.ones(3)}, [1.0, 1.0, 1.0], None),
        ({"tau": table}, [0.5, 0.75, 0.0], {"J": np.array([2.0, 2.0, 1.0])}),
        ({"tau": tx.ZeroOrderHold([0.0, 0.25], [[9.0, 9.0, 9.0], [1.0, 2.0, 3.0]])}, [1.0, 2.0, 3.0], None),
        (lambda t: {"tau": jnp.stack([t, 1.0 - t, 2.0 * t])}, [0.25, 0.75, 0.5], {"J": np.ones(3)}),
    ):
        rates = dynamics(0.25, x0, {"tau": np.array(now)}, params)
        expected = moved(dynamics, term, x0, np.concatenate([rates["w"], x0["w"]]))
        found = term.vf(0.25, y0, (u, params))
        for name in ("R", "w"):
            np.testing.assert_allclose(found[name], expected[name], atol=1e-13)
    integrated = tx.integrate(dynamics, x0, t1=1.0, dt=2e-3, u=u, params=params, save_at=TIMES).xs
    ambient = solve(term, x0, (u, params))
    for name in ("R", "w"):
        np.testing.assert_allclose(ambient[name], integrated[name], atol=1e-9)
