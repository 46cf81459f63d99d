"""Bearing force: a bar on a hinge is released from the horizontal, and its joint reaction agrees with the textbook."""

import jax
import numpy as np
from matplotlib import pyplot as plt

import twistax as tx
from twistax.mechanics import SpatialInertia, joints

jax.config.update("jax_enable_x64", True)

# A uniform bar hanging from its end along -z; the hinge turns about y. The parent of the joint is the world.
mass, length, gravity = 2.0, 1.2, 9.81  # kg, m, m/s2
rod, thick = mass * length**2 / 12.0, 1e-3  # kg m2, about the centre of mass
hinge = joints.Revolute("hinge", axis=(0.0, 1.0, 0.0))
arm = SpatialInertia(mass=mass, center_of_mass=(0.0, 0.0, -0.5 * length), inertia=np.diag([rod, rod, thick]))

# Newton and Euler along the hinge: H' (M H q'' + ad*_V(M V) - weight) = 0.
H, V, T = hinge.motion_subspace, hinge.twist, hinge.transform
weight = arm.weight(T, gravity=(0.0, 0.0, -gravity))
inertial = tx.lie.AdjointDual(V, arm.momentum(V))
rate = tx.linalg.Solve(H.T @ arm.matrix @ H, hinge.actuation(weight - inertial))
needed = arm.matrix @ (H @ rate) + inertial  # the sum of all wrenches on the arm, in its axes
system = tx.System(
    rates={**hinge.rates, hinge.velocity: rate},
    outputs={
        "energy": arm.kinetic_energy(V) + mass * gravity * tx.lie.Act(T, arm.center_of_mass)[2],
        "bearing": hinge.reaction(needed - weight),
    },
)
dynamics = tx.compile(system)

start = {"hinge_position": np.array([0.5 * np.pi]), "hinge_velocity": np.zeros(1)}
sol = tx.integrate(dynamics, start, t1=2.0, dt=1e-3, save_at=np.linspace(0.0, 2.0, 101))
found = jax.vmap(dynamics.outputs)(sol.ts, sol.xs)

# The textbook: for a bar let go from the horizontal, 5/2 m g cos(angle) along it and 1/4 m g sin(angle) across it.
angles = np.asarray(sol.xs["hinge_position"][:, 0])
along, across = 2.5 * mass * gravity * np.cos(angles), 0.25 * mass * gravity * np.sin(angles)
print("  t     angle (deg)   along (N)   textbook   across (N)   textbook   energy (J)")
rows = zip(sol.ts, np.rad2deg(angles), found["bearing"][:, 2], along, -found["bearing"][:, 0], across, found["energy"])
for row in list(rows)[::10]:
    print("{:4.1f}   {:11.4f}   {:9.5f}   {:8.5f}   {:10.5f}   {:8.5f}   {:10.2e}".format(*map(float, row)))

miss = max(np.abs(found["bearing"][:, 2] - along).max(), np.abs(-found["bearing"][:, 0] - across).max())
print(f"largest difference from the textbook: {miss:.1e} N")
if not miss < 1e-8 or np.ptp(found["energy"]) > 1e-9:
    raise SystemExit("the joint reaction differs from that of the textbook")

figure, axes = plt.subplots(figsize=(6.0, 3.0), layout="constrained")
axes.plot(sol.ts, found["bearing"][:, 2], label="along the bar")
axes.plot(sol.ts, -found["bearing"][:, 0], label="across the bar")
axes.plot(sol.ts[::5], along[::5], "k.", markersize=3, label="textbook")
axes.plot(sol.ts[::5], across[::5], "k.", markersize=3)
axes.set(xlabel="time, s", ylabel="force of the bearing, N")
axes.legend(frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0))
figure.savefig("hinged_arm.png", dpi=100)
