"""Spherical pendulum: one rotation state on SO(3), a torque as control, and a torque as a function of time."""

import jax
import numpy as np
from matplotlib import pyplot as plt

import twistax as tx

jax.config.update("jax_enable_x64", True)

R = tx.State("R", group=tx.SO3, kind=tx.kinds.Rotation("world", "body"))
w = tx.State("w", shape=(3,), kind=tx.FreeVector("body"), unit="rad/s")
torque = tx.Control("torque", shape=(3,), kind=tx.FreeVector("body"), unit="N m")  # at the pivot
m, l, gravity = 1.0, 0.7, np.array([0.0, 0.0, -9.81])  # kg, m, m/s2
J = np.diag([m * l**2, m * l**2, 0.01])  # about the pivot, kg m2
arm = np.array([0.0, 0.0, -l])  # pivot to bob in the body frame, m

weight = tx.linalg.Cross(arm, R.T @ (m * gravity))
pendulum = tx.System(
    rates={R: w, w: tx.linalg.Solve(J, weight + torque - tx.linalg.Cross(w, J @ w))},
    outputs={
        "energy": 0.5 * w @ (J @ w) - m * gravity @ (R @ arm),
        "tilt": tx.Acos(tx.Min(tx.Max((R @ arm)[2] / -l, -1.0), 1.0)),
    },
)
dynamics = tx.compile(pendulum)

start = {"R": tx.lie.so3.exp(np.array([2.0, 0.0, 0.0])), "w": np.zeros(3)}
times = np.linspace(0.0, 4.0, 81)
free = tx.integrate(dynamics, start, t1=4.0, dt=1e-3, u={"torque": np.zeros(3)}, save_at=times)
driven = tx.integrate(
    dynamics,
    start,
    t1=4.0,
    dt=1e-3,
    u=lambda t: {"torque": jax.numpy.stack([jax.numpy.sin(3.0 * t), 0 * t, 0 * t])},
    save_at=times,
)

read = jax.vmap(lambda t, x: dynamics.outputs(t, x))
print("  t     tilt, free (deg)   energy, free (J)   tilt, driven (deg)")
rows = zip(times, read(free.ts, free.xs)["tilt"], read(free.ts, free.xs)["energy"], read(driven.ts, driven.xs)["tilt"])
for t, tilt, energy, other in list(rows)[::10]:
    print(f"{t:4.1f}   {np.rad2deg(tilt):12.4f}   {energy:18.9f}   {np.rad2deg(other):14.4f}")

energies = read(free.ts, free.xs)["energy"]
if np.ptp(energies) > 1e-8:
    raise SystemExit("the energy of the free pendulum drifts")

figure, axes = plt.subplots(figsize=(6.0, 3.0), layout="constrained")
axes.plot(times, np.rad2deg(read(free.ts, free.xs)["tilt"]), label="free")
axes.plot(times, np.rad2deg(read(driven.ts, driven.xs)["tilt"]), label="driven")
axes.set(xlabel="time, s", ylabel="tilt, deg")
axes.legend(frameon=False)
figure.savefig("pendulum.png", dpi=100)
