"""A Panda arm with its motors off, let fall for a second: where its tip goes, and whether its energy stays."""

import jax
import numpy as np

import twistax as tx
from twistax.mechanics import chain_models, forward_dynamics

jax.config.update("jax_enable_x64", True)

arm = chain_models.panda()
q, qd = tx.State("q", shape=(arm.dofs,)), tx.State("qd", shape=(arm.dofs,))
tau = tx.Control("tau", shape=(arm.dofs,))

system = tx.System(
    rates={q: qd, qd: forward_dynamics(arm, q, qd, tau)},
    outputs={"energy": arm.energy(q, qd), "tip": arm.poses(q)[-1][:3, 3]},
)
dynamics = tx.compile(system)

start = {"q": np.array([0.0, -0.3, 0.0, -2.2, 0.0, 2.0, 0.8]), "qd": np.zeros(arm.dofs)}  # rad, rad/s
motors = {"tau": np.zeros(arm.dofs)}  # N m
sol = tx.integrate(dynamics, start, t1=1.0, dt=5e-4, u=motors)
end = {name: values[-1] for name, values in sol.xs.items()}

before, after = dynamics.outputs(0.0, start, motors), dynamics.outputs(1.0, end, motors)
print("tip at the start (m):", np.round(before["tip"], 4))
print("tip after 1 s (m):   ", np.round(after["tip"], 4))
print("fastest joint then (rad/s):", f"{np.max(np.abs(end['qd'])):.1f}")
drift = abs(float(after["energy"] - before["energy"]))
print(f"drift of the energy: {drift:.1e} J of {float(before['energy']):.1f} J")
if not drift < 1e-5:
    raise SystemExit("a falling arm without friction keeps its energy")
