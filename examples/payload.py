"""Mass estimation: the mass that an arm holds, from a measured motion, by the derivative of a rollout."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib import pyplot as plt

import twistax as tx
from twistax.mechanics import load

jax.config.update("jax_enable_x64", True)

arm = load(Path(__file__).with_name("arm.urdf"), parameters=["tool_mass"])  # 0.2 kg, says the file
dynamics = tx.compile(arm.system())
start, u = {"q": np.array([0.3, -0.4, 0.1]), "qd": np.zeros(3)}, {"tau": np.array([2.0, -1.0, 3.0])}


@jax.jit
def motion(mass):
    """The joints at 26 times (26, 3)."""
    times = np.linspace(0.0, 0.5, 26)
    return tx.integrate(dynamics, start, t1=0.5, steps=50, u=u, params={"tool_mass": mass}, save_at=times).xs["q"]


true = 0.75
seen = motion(jnp.asarray(true)) + 1e-4 * np.random.default_rng(0).normal(size=(26, 3))
slope = jax.jit(jax.jacfwd(motion))
mass, path = jnp.asarray(0.2), [0.2]
for _ in range(6):  # Gauss and Newton
    misfit, J = (motion(mass) - seen).ravel(), slope(mass).ravel()
    mass = mass - J @ misfit / (J @ J)
    path.append(float(mass))
spread = 1e-4 / np.sqrt(J @ J)
print("mass after each step (kg):", *(f"{m:.5f}" for m in path))
print(f"found {path[-1]:.5f} kg +- {spread:.5f}, true {true} kg; nothing was compiled anew")
if abs(path[-1] - true) > 4.0 * spread:
    raise SystemExit("the mass is found to within its spread")

masses = np.linspace(0.1, 1.4, 60)
figure, axes = plt.subplots(figsize=(5.0, 3.0), layout="constrained")
axes.semilogy(masses, [float(jnp.linalg.norm(motion(jnp.asarray(m)) - seen)) for m in masses])
axes.plot(path, [float(jnp.linalg.norm(motion(jnp.asarray(m)) - seen)) for m in path], "o")
axes.set(xlabel="mass (kg)", ylabel="misfit (rad, m)")
figure.savefig("payload.png", dpi=100)
