"""Panda from URDF: five lines load and simulate the arm, which falls with its motors off and conserves its energy."""

from pathlib import Path

import jax
import numpy as np
from matplotlib import pyplot as plt

import twistax as tx
from twistax.mechanics import load

jax.config.update("jax_enable_x64", True)

arm = load(Path(__file__).with_name("panda.urdf"))
dynamics = tx.compile(arm.system(outputs={"energy": arm.energy(), "flange": arm.pose("flange")[:3, 3]}))
start, motors = {"q": np.array([0.0, -0.3, 0.0, -2.2, 0.0, 2.0, 0.8]), "qd": np.zeros(7)}, {"tau": np.zeros(7)}
times = np.linspace(0.0, 1.0, 101)
sol = tx.integrate(dynamics, start, t1=1.0, dt=5e-4, u=motors, save_at=times)

found = jax.vmap(lambda t, x: dynamics.outputs(t, x, motors))(sol.ts, sol.xs)
flange, energy = np.asarray(found["flange"]), np.asarray(found["energy"])
print("flange at the start (m):", np.round(flange[0], 4))
print("flange after 1 s (m):   ", np.round(flange[-1], 4))
print("fastest joint then (rad/s):", f"{np.max(np.abs(sol.xs['qd'][-1])):.1f}")
drift = np.abs(energy - energy[0]).max()
print(f"drift of the energy: {drift:.1e} J of {energy[0]:.1f} J")
if not drift < 1e-5:
    raise SystemExit("the energy of the arm drifts")

figure, (left, right) = plt.subplots(1, 2, figsize=(9.0, 3.0), layout="constrained")
left.plot(times, flange, label=["x", "y", "z"])
left.set(xlabel="t (s)", ylabel="position of the flange (m)")
left.legend()
right.plot(times, sol.xs["q"], label=arm.joints)
right.set(xlabel="t (s)", ylabel="joint angles (rad)")
right.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize="small")
figure.savefig("panda.png", dpi=100)
