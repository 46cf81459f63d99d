"""Quadrotor: a simulation from a table of rotor thrusts, and the gradient of the final position in this table."""

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib import pyplot as plt

import twistax as tx

jax.config.update("jax_enable_x64", True)

mass, J, arm, drag = 0.8, np.diag([5e-3, 5e-3, 9e-3]), 0.17, 0.016  # kg, kg m2, m, m (rotor drag per thrust)
g = tx.State("g", group=tx.SE3, kind=tx.kinds.Pose("world", "body"))
V = tx.State("V", shape=(6,), kind=tx.Twist("body", of="quadrotor", relative_to="world"))
rotors = tx.Control("rotors", shape=(4,), min=0.0, max=6.0, unit="N")  # thrusts

# Thrust and torques of a plus frame: each row is linear in the four thrusts.
mixer = np.array([[1, 1, 1, 1], [0, arm, 0, -arm], [-arm, 0, arm, 0], [drag, -drag, drag, -drag]], float)
lift = mixer @ rotors
weight = g[:3, :3].T @ np.array([0.0, 0.0, -9.81 * mass])
wrench = tx.lie.wrench(force=weight + tx.Concat(0.0, 0.0, lift[0]), torque=lift[1:])
M = np.block([[mass * np.eye(3), np.zeros((3, 3))], [np.zeros((3, 3)), J]])

quadrotor = tx.System(rates={g: V, V: tx.linalg.Solve(M, wrench - tx.lie.AdjointDual(V, M @ V))})
dynamics = tx.compile(quadrotor)

hover = mass * 9.81 / 4
times = np.array([0.0, 0.5, 0.6, 0.8, 0.9, 2.0])
thrusts = hover * np.ones((6, 4)) + 0.05 * np.outer([0, 0, 1, -1, 0, 0], [0, 1, 0, -1])
start = {"g": tx.pose(position=[0.0, 0.0, 1.0]), "V": np.zeros(6)}


def fly(table: jax.Array) -> jax.Array:
    """Where the vehicle is after two seconds, (3,) in m."""
    end = tx.integrate(dynamics, start, t1=2.0, dt=5e-3, u={"rotors": tx.FirstOrderHold(times, table)})
    return end.xs["g"][-1, :3, 3]


print("position after 2 s (m):", np.round(fly(jnp.asarray(thrusts)), 4))
sideways = jax.grad(lambda table: fly(table)[1])(jnp.asarray(thrusts))
print("d(sideways)/d(thrust), rows are table times, columns rotors (m/N):")
print(np.round(sideways, 4))

saved = np.linspace(0.0, 2.0, 101)
table = tx.FirstOrderHold(times, thrusts)
flight = tx.integrate(dynamics, start, t1=2.0, dt=5e-3, u={"rotors": table}, save_at=saved)
figure, (left, right) = plt.subplots(1, 2, figsize=(8.0, 3.0), layout="constrained")
left.plot(times, thrusts, ".-", label=["rotor 1", "rotor 2", "rotor 3", "rotor 4"])
left.set(xlabel="time, s", ylabel="thrust, N")
left.legend(frameon=False)
right.plot(saved, flight.xs["g"][:, :3, 3], label=["x", "y", "z"])
right.set(xlabel="time, s", ylabel="position, m")
right.legend(frameon=False)
figure.savefig("quadrotor.png", dpi=100)
