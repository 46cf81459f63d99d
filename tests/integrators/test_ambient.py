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
def flights() -> dict[str, dict]:
    dynamics = forced()
    fixed = tx.integrate(dynamics, start(), t1=1.0, dt=1e-3, save_at=TIMES).xs
    both = {q: solve(tx.diffrax.ambient_term(dynamics, quaternion=q), start(), None) for q in (True, False)}
    return {"fixed": fixed, "quaternion": both[True], "matrix": both[False]}


@pytest.mark.parametrize("kind", ["quaternion", "matrix"])
def test_the_ambient_flight_is_the_flight_on_the_group(flights: dict[str, dict], kind: str) -> None:
    for name in ("g", "V"):
        np.testing.assert_allclose(flights[kind][name], flights["fixed"][name], atol=1e-9)


def test_rotations_controls_and_parameters() -> None:
    """SO(3) in quaternions; u and params travel in args, new numbers of both without a new term."""
    R, w, tau = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,)), tx.Control("tau", shape=(3,))
    J = tx.Parameter("J", shape=(3,), value=[1.0, 2.0, 3.0])
    dynamics = tx.compile(tx.System(rates={w: (tx.linalg.Cross(J * w, w) + tau) / J, R: w}))
    x0 = {"R": np.eye(3), "w": np.array([0.5, 2.0, -1.0])}
    term = tx.diffrax.ambient_term(dynamics)
    assert {name: value.shape for name, value in term.to_ambient(x0).items()} == {"w": (3,), "R": (4,)}
    table = tx.Linear([0.0, 1.0], [[0.0, 1.0, 0.0], [2.0, 0.0, 0.0]])
    for u, params in (
        ({"tau": np.ones(3)}, None),
        ({"tau": table}, {"J": np.array([2.0, 2.0, 1.0])}),
        (lambda t: {"tau": jnp.stack([t, 1.0 - t, jnp.sin(t)])}, {"J": np.ones(3)}),
    ):
        flown = tx.integrate(dynamics, x0, t1=1.0, dt=2e-3, u=u, params=params, save_at=TIMES).xs
        ambient = solve(term, x0, (u, params))
        for name in ("R", "w"):
            np.testing.assert_allclose(ambient[name], flown[name], atol=1e-9)


def test_angular_first_poses_and_round_trips() -> None:
    g, xi = tx.State("g", group=tx.SE3, order=tx.ANGULAR_FIRST), tx.Parameter("xi", shape=(6,))
    dynamics = tx.compile(tx.System(rates={g: xi}))
    x0 = {"g": start()["g"]}
    params = {"xi": np.array([0.3, -1.0, 0.5, 0.7, 0.2, -0.9])}
    flown = tx.integrate(dynamics, x0, t1=1.0, dt=0.1, params=params, save_at=TIMES).xs["g"]
    for quaternion, shape in ((True, (7,)), (False, (4, 4))):
        term = tx.diffrax.ambient_term(dynamics, quaternion=quaternion)
        assert term.to_ambient(x0)["g"].shape == shape
        np.testing.assert_allclose(term.from_ambient(term.to_ambient(x0))["g"], x0["g"], atol=1e-14)
        np.testing.assert_allclose(solve(term, x0, (None, params))["g"], flown, atol=1e-9)


def test_wrong_arguments_are_named() -> None:
    dynamics = forced()
    term = tx.diffrax.ambient_term(dynamics)
    with pytest.raises(tx.InputError, match="unknown key 'x' in x"):
        term.to_ambient({"x": np.zeros(3)})
    with pytest.raises(tx.InputError, match="unknown key 'k' in params"):
        term.vf(0.0, term.to_ambient(start()), (None, {"k": 1.0}))
