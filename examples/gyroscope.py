"""Gyroscope: a fast top on its tip precesses about the vertical at a rate of m g l / (J3 w3), with nutation.

The attitude is a state on SO(3), so there is no singularity when the axis is vertical.
"""

import jax
import numpy as np
from matplotlib import pyplot as plt

import twistax as tx

jax.config.update("jax_enable_x64", True)

mass, length, gravity = 0.5, 0.06, 9.81  # kg, m from the tip to the centre of mass, m/s2
J = np.array([2.4e-3, 2.4e-3, 6.0e-4])  # about the tip, kg m2; the axis of symmetry is z
R = tx.State("R", group=tx.SO3, kind=tx.kinds.Rotation("world", "top"))
w = tx.State("w", shape=(3,), kind=tx.FreeVector("top"), unit="rad/s")
weight = R.T @ np.array([0.0, 0.0, -mass * gravity])
torque = tx.linalg.Cross(np.array([0.0, 0.0, length]), weight)
top = tx.System(
    rates={R: w, w: (torque - tx.linalg.Cross(w, J * w)) / J},
    outputs={"axis": R @ np.array([0.0, 0.0, 1.0]), "energy": 0.5 * w @ (J * w) + mass * gravity * length * R[2, 2]},
)
dynamics = tx.compile(top)

spin = 250.0  # rad/s
start = {"R": tx.lie.so3.exp(np.array([0.6, 0.0, 0.0])), "w": np.array([0.0, 0.0, spin])}
times = np.linspace(0.0, 3.0, 1501)
solution = tx.integrate(dynamics, start, t1=3.0, rtol=1e-9, save_at=times)
axis, energy = np.asarray(solution.outputs["axis"]), np.asarray(solution.outputs["energy"])

heading = np.unwrap(np.arctan2(axis[:, 1], axis[:, 0]))
measured, expected = (heading[-1] - heading[0]) / times[-1], mass * gravity * length / (J[2] * spin)
print(f"precession {measured:.4f} rad/s, of a fast top {expected:.4f} rad/s")
print(f"nutation: the axis leans between {np.rad2deg(np.arccos(axis[:, 2])).min():.2f} and", end=" ")
print(f"{np.rad2deg(np.arccos(axis[:, 2])).max():.2f} degrees; energy drifts by {np.ptp(energy):.1e} J")

figure, axes = plt.subplots(figsize=(4.2, 4.0), layout="constrained")
axes.plot(axis[:, 0], axis[:, 1], linewidth=0.8)
axes.set(xlabel="x of the axis", ylabel="y of the axis", aspect="equal", title="tip of the axis, seen from above")
figure.savefig("gyroscope.png", dpi=100)
if abs(measured / expected - 1.0) > 0.03:
    raise SystemExit("the precession differs from m g l / (J3 w3)")
