"""Integrations that end early: the error compiles nothing, and never ends the process."""

import subprocess
import sys
from typing import Any

import numpy as np
import pytest

import twistax as tx
from twistax.mechanics import Drive, Link, Mechanism, SpatialInertia, joints, spatial_momentum

RADAU = tx.ImplicitRKMK(tx.tableaus.RADAU_IIA5)


def sloshing_tank() -> tuple[tx.Dynamics, dict[str, Any]]:
    """A hub with a bob of 20 kg that has almost no inertia about its own centre: it decays at 9e5 1/s."""
    hub = SpatialInertia(mass=750.0, inertia=np.diag([900.0, 800.0, 600.0]))
    bob = SpatialInertia(mass=20.0, center_of_mass=(0, 0, -0.3), inertia=1e-6 * np.eye(3))
    joint, place = joints.Spherical("tank"), tx.pose(position=[0.1, 0.1, -0.2])
    links = [
        Link(joints.Free("hub"), hub, tx.pose()),
        Link(joint, bob, place, parent="hub", drive=Drive(damping=0.9)),
    ]
    mechanism = Mechanism(links, gravity=(0.0, 0.0, 0.0))
    outputs = {"energy": mechanism.energy(), "momentum": spatial_momentum(mechanism)}
    start = {
        "hub_position": tx.pose(),
        "tank_position": tx.lie.so3.exp(np.array([0.3, 0.2, 0.0])),
        "qd": np.array([0, 0, 0, 1.0, 0.5, 0.1, 0.5, 0.3, 0.0]),
    }
    return tx.compile(mechanism.system(controls=[], outputs=outputs)), start


@pytest.mark.parametrize(
    "how",
    [pytest.param({"rtol": 1e-8, "save_at": np.linspace(0.0, 1.0, 11)}, marks=pytest.mark.slow), {"dt": 5e-3}],
    ids=["rtol", "dt"],
)
def test_a_rate_of_a_million_is_no_trouble_for_radau(how: dict[str, Any]) -> None:
    """Rounding of terms that cancel in the rates is far above that of the states: Newton's method ends at its noise."""
    dynamics, start = sloshing_tank()
    before = dynamics.outputs(0.0, start)
    found = tx.integrate(dynamics, start, t1=1.0, method=RADAU, **how)
    after = {name: np.asarray(value)[-1] for name, value in found.outputs.items()}
    size = np.abs(before["momentum"]).max()
    assert np.abs(after["momentum"] - before["momentum"]).max() < 1e-5 * size
    assert before["energy"] - 40.0 < after["energy"] < before["energy"]


@pytest.mark.parametrize("how", [{"rtol": 1e-9, "save_at": np.linspace(0.0, 1.0, 41)}, {"dt": 2e-3}], ids=repr)
def test_noise_of_the_rates_does_not_stop_radau(how: dict[str, Any]) -> None:
    """x' = 9e5 (cos y - x) with terms of 1e5 that cancel, which no rounding of the states shows."""
    x, y = tx.State("x"), tx.State("y")
    many = 1e5 * (1.0 + tx.Sin(7.0 * y))
    dynamics = tx.compile(
        tx.System(rates={x: 9e5 * ((tx.Cos(y) + many * (1.0 + x)) - (x + many + many * x)), y: 1.0 + 0.0 * y})
    )
    found = tx.integrate(dynamics, {"x": 1.0, "y": 0.0}, t1=1.0, method=RADAU, **how)
    assert found.xs["x"][-1] == pytest.approx(np.cos(1.0), abs=2e-6)


def test_an_implicit_step_evaluated_by_itself_does_not_end_the_process() -> None:
    """JAX evaluates what `custom_root` holds piece by piece, outside of any program."""
    code = """
import jax, numpy as np, twistax as tx
jax.config.update("jax_enable_x64", True)
R, w = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,))
dynamics = tx.compile(tx.System(rates={R: w, w: -1e5 * w + tx.linalg.Cross(w, tx.Constant(np.array([1.0, 2.0, 3.0])))}))
method = tx.ImplicitRKMK(tx.tableaus.RADAU_IIA5)
from twistax.integrators.options import Options, plan_of
x0 = {"R": np.eye(3), "w": np.ones(3)}
plan = plan_of(dynamics, x0, Options(t1=1.0, dt=0.1, method=method))
t, h = jax.numpy.asarray(0.0), jax.numpy.asarray(0.1)
print(method.step(plan.stepper.field(t, h), t, jax.tree.map(jax.numpy.asarray, plan.x), h)["w"].shape)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.strip() == "(3,)"
