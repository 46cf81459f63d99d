"""Payload: a Panda holds an unknown load, and a fit to its torque sensors estimates the load."""

from pathlib import Path

import jax
import numpy as np
from matplotlib import pyplot as plt

import twistax as tx
from twistax import mechanics
from twistax.estimation import Experiment

jax.config.update("jax_enable_x64", True)

pose = np.array([0.0, -0.3, 0.0, -2.2, 0.0, 2.0, 0.8])
panda = mechanics.load(Path(__file__).with_name("panda.urdf"))
arm = panda.lock(dict(zip(panda.joints[:4], pose[:4])))  # the wrist alone moves
guess = mechanics.SpatialInertia(mass=0.1, inertia=1e-4 * np.eye(3))
held = tx.Parameter("held", shape=(10,), value=mechanics.log_cholesky(guess))  # any ten numbers are a physical body
loaded = arm.with_inertia({"flange": mechanics.physical_inertia(held)})

# The motion is known from the encoders: a sum of waves for each joint. The torques follow from it and the load.
qdd = tx.Control("qdd", shape=(3,))
torques = mechanics.inverse_dynamics(loaded, qdd=qdd)
q, qd = (next(leaf for leaf in loaded.system().states if leaf.name == name) for name in ("q", "qd"))
moving = tx.compile(tx.System(rates={q: qd, qd: qdd}, outputs={"torques": torques}))
NOISE = 0.02  # N m
sensor = tx.Measurement("torques", torques, covariance=NOISE**2)

times, rng = np.arange(0.0, 4.0, 0.05), np.random.default_rng(0)
waves = np.sin(np.outer(times, rng.uniform(2.0, 6.0, 3)) + rng.uniform(0.0, 6.0, 3)) * rng.uniform(8.0, 20.0, 3)
start = {"q": pose[4:], "qd": np.zeros(3)}
u = {"qdd": tx.ZeroOrderHold(times, waves)}
path = tx.integrate(moving, start, t1=times[-1], dt=0.05, u=u, params={"held": held.value}, save_at=times)

mass, center, tensor = 1.3, np.array([0.02, -0.05, 0.12]), np.diag([6e-3, 5e-3, 3e-3])  # kg, m, kg m2
true = mechanics.log_cholesky(mechanics.SpatialInertia(mass=mass, center_of_mass=center, inertia=tensor))
held_over = waves[np.maximum(np.arange(len(times)) - 1, 0)]  # the acceleration of the step that ends at each time


@jax.jit
def torques_of(load):
    """The torques at all times (k, 3)."""
    at = lambda t, x, a: moving.outputs(t, x, {"qdd": a}, {"held": load})["torques"]  # noqa: E731
    return jax.vmap(at)(times, path.xs, held_over)


measured = torques_of(true) + NOISE * rng.normal(size=(len(times), 3))
record = Experiment({"torques": (times, measured)}, start, P0=0.0, u=u)
prior = {"held": (held.value, np.repeat([4.0, 0.1**2], [7, 3]))}  # within a factor of e^2, its centre within 0.1 m
fit = tx.fit(moving, record, free=["held"], measurements=[sensor], priors=prior, segments=1)
numbers, deviations = np.asarray(fit.params["held"]), fit.deviations()["held"]
found, spread = np.exp(2.0 * numbers[0]), 2.0 * np.exp(2.0 * numbers[0]) * deviations[0]
print(f"{fit.result} after {fit.iterations} steps")
print(f"mass {found:.4f} kg +- {spread:.4f}, true {mass} kg")
print(f"centre of mass (m): {np.round(numbers[7:], 4)} +- {np.round(deviations[7:], 4)}, true {center}")
if abs(found - mass) > 4.0 * spread or (np.abs(numbers[7:] - center) > 4.0 * deviations[7:]).any():
    raise SystemExit("the error of the load exceeds its deviations")

figure, axes = plt.subplots(1, 2, figsize=(9.0, 3.0), layout="constrained")
for axis, load, title in ((axes[0], held.value, "before the fit"), (axes[1], numbers, "after it")):
    axis.plot(times, measured - torques_of(load), lw=0.8)
    axis.axhspan(-3.0 * NOISE, 3.0 * NOISE, color="0.9")
    axis.set(xlabel="t (s)", ylabel="misfit of the torques (N m)", title=title)
figure.savefig("payload.png", dpi=100)
