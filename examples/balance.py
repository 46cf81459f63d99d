"""LQR on a rotation: a linear feedback law balances a rigid pendulum upright from a tilt of forty degrees.

`tx.trajectory.linearize` gives A and B in the tangent space, so the law acts on the rotation vector of the error.
"""

import jax
import numpy as np
from matplotlib import pyplot as plt
from scipy.linalg import solve_continuous_are

import twistax as tx

jax.config.update("jax_enable_x64", True)

m, l, J = 2.0, 0.5, np.array([0.55, 0.55, 0.02])  # kg; pivot to centre of mass, m; about the pivot, kg m2
R, w = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,))  # body to world; body rate, rad/s
torque = tx.Control("torque", shape=(3,))  # N m, in body axes
weight = tx.linalg.Cross(np.array([0.0, 0.0, l]), R.T @ np.array([0.0, 0.0, -9.81 * m]))


def pendulum(torque):
    rates = {R: w, w: (weight + torque - tx.linalg.Cross(w, J * w)) / J}
    return tx.compile(tx.System(rates=rates, outputs={"lean": R[2, 2], "torque": torque}))


upright = {"R": np.eye(3), "w": np.zeros(3)}
linear = tx.trajectory.linearize(pendulum(torque), 0.0, upright, {"torque": np.zeros(3)})
A, B = np.asarray(linear.A), np.asarray(linear.B)
print("unstable modes, 1/s:", np.round(np.linalg.eigvals(A).real.max(), 3))
Q, weights = np.diag([100.0] * 3 + [1.0] * 3), np.eye(3)
K = B.T @ solve_continuous_are(A, B, Q, weights)  # (3, 6)
print("slowest closed-loop mode, 1/s:", np.round(np.linalg.eigvals(A - B @ K).real.max(), 3))

error = tx.Concat(tx.lie.SO3Log(R), w)  # rotation vector and body rate
closed = pendulum(-(K @ error))
start = {"R": tx.lie.so3.exp(np.deg2rad([30.0, -25.0, 0.0])), "w": np.zeros(3)}
times = np.linspace(0.0, 3.0, 301)
solution = tx.integrate(closed, start, t1=3.0, rtol=1e-9, save_at=times)
lean = np.rad2deg(np.arccos(np.clip(solution.outputs["lean"], -1.0, 1.0)))
print(f"lean: {lean[0]:.1f} degrees at the start, {lean[-1]:.4f} after 3 s")

figure, (left, right) = plt.subplots(1, 2, figsize=(8.0, 3.0), layout="constrained")
left.plot(times, lean)
left.set(xlabel="time, s", ylabel="lean, deg")
right.plot(times, solution.outputs["torque"], label=["x", "y", "z"])
right.set(xlabel="time, s", ylabel="torque, N m")
right.legend(frameon=False)
figure.savefig("balance.png", dpi=100)
if lean[-1] > 0.1:
    raise SystemExit("the control law does not balance the pole")
