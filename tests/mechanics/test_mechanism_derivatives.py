"""Derivatives of the dynamics against differences in extended precision, and against those on the graph of scalars."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import twistax as tx
from twistax import mechanics
from twistax.mechanics import Link, Mechanism, SpatialInertia, joints

EXAMPLES = Path(__file__).parents[2] / "examples"


def test_in_single_precision(unchecked: None) -> None:
    """Derivatives in float32, which take everything else, are near those in float64."""
    system, rng = mechanics.load(EXAMPLES / "arm.urdf").system(), np.random.default_rng(9)
    dynamics = tx.compile(system, backend=tx.Native(least=0))
    at = {"q": rng.normal(size=(20, 3)), "qd": rng.normal(size=(20, 3))}, {"tau": rng.normal(size=(20, 3))}
    found = []
    for dtype in (np.float32, np.float64):
        x, u = jax.tree.map(lambda a, dtype=dtype: jnp.asarray(a, dtype), at)
        found.append(np.asarray(jax.vmap(lambda x, u: dynamics.jacobian(0.0, x, u))(x, u)["x"]))
        assert found[-1].dtype == dtype
    assert np.max(np.abs(found[0] - found[1])) < 2e-5 * np.max(np.abs(found[1]))


@pytest.mark.slow
def test_free_arm_keeps_its_momentum(unchecked: None) -> None:
    """Ten links on a free body, 100 s without motors: the linear and the angular momentum about the base's origin."""
    hull = SpatialInertia(mass=120.0, inertia=np.diag([20.0, 18.0, 15.0]))
    rod = SpatialInertia(mass=6.0, center_of_mass=(0.25, 0.0, 0.0), inertia=np.diag([0.02, 0.13, 0.13]))
    links = [Link(joints.Free("hull"), hull, tx.pose())]
    for k in range(10):
        hinge = joints.Revolute(f"hinge{k}", ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0))[k % 2])
        links.append(Link(hinge, rod, tx.pose(position=[0.5, 0.0, 0.0]), parent=links[-1].name))
    robot, rng = Mechanism(links, gravity=np.zeros(3)), np.random.default_rng(0)
    outputs = {"momentum": mechanics.spatial_momentum(robot), "energy": robot.energy()}
    dynamics = tx.compile(robot.system(controls=(), outputs=outputs))
    qd = np.concatenate([[0.1, -0.05, 0.02], 0.1 * rng.normal(size=3), 0.2 * rng.normal(size=10)])
    start, method = {"q": 0.3 * rng.normal(size=10), "hull_position": np.eye(4), "qd": qd}, tx.RKMK(tx.tableaus.DOP853)
    sol = tx.integrate(dynamics, start, t1=100.0, dt=5e-3, method=method, save_at=np.linspace(0.0, 100.0, 11))
    kept = jax.tree.map(np.asarray, jax.vmap(dynamics.outputs)(sol.ts, sol.xs))
    for own in (kept["momentum"][:, :3], kept["momentum"][:, 3:], kept["energy"][:, None]):
        assert np.max(np.abs(own - own[0])) < 1e-12 * np.linalg.norm(own[0])
