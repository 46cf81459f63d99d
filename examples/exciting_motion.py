"""Exciting motion: the most informative motion within limits for the identification of the masses of an arm."""

import jax
import numpy as np
from matplotlib import pyplot as plt

import twistax as tx
from twistax import mechanics
from twistax.mechanics import Drive, Link, SpatialInertia, joints

jax.config.update("jax_enable_x64", True)
NOISE, PERIOD, HARMONICS = 0.2, 2.0, 4  # of the torques, N m; of the motion, s


def link(name, mass, effort, x):
    body = SpatialInertia(mass=mass, center_of_mass=(0.2, 0.02, 0.0), inertia=mass * np.diag([0.002, 0.02, 0.02]))
    drive = Drive(lower=-1.5, upper=1.5, speed=4.0, effort=effort)
    return Link(joints.Revolute(name, (0.0, 1.0, 0.0)), body, tx.pose(position=[x, 0.0, 0.0]), drive=drive)


arm = mechanics.Chain([link("shoulder", 3.0, 60.0, 0.0), link("elbow", 1.5, 15.0, 0.4)])
problem = tx.trajectory.exciting_problem(arm, period=PERIOD, harmonics=HARMONICS, noise=NOISE)
result = problem.solve(max_iterations=150)
print(result.message)

# The deviation of the masses from a period of measured torques, for this motion and for random ones.
times = np.arange(0.0, PERIOD, 0.01)
torques = jax.jit(jax.vmap(tx.lower(mechanics.inverse_dynamics(arm, qdd=tx.State("qdd", (2,)))), in_axes=(None, 0)))


def motion(coefficients):
    return mechanics.fourier_motion(coefficients, PERIOD, times)


def deviation(records):
    """The root mean square deviation of the combinations of masses, first moments and inertias."""
    records = records | {"tau": torques(0.0, records)}
    return np.sqrt(np.mean(mechanics.identify(arm, records, noise=NOISE).standard_deviations ** 2))


def random_motion(rng):
    """A random series within the limits."""
    coefficients = rng.normal(size=(2, 2 * HARMONICS + 1))
    coefficients[:, 0] = 0.0
    for size in np.geomspace(4.0, 0.01, 100):
        records = motion(size * coefficients)
        used = [np.abs(records["q"]) / 1.5, np.abs(records["qd"]) / 4.0, np.abs(torques(0.0, records)) / [60.0, 15.0]]
        if np.max(used) <= 1.0:
            return records
    raise SystemExit("no size is within the limits")


best = motion(result.params["coefficients"])
others = [random_motion(np.random.default_rng(seed)) for seed in range(20)]
deviations = [deviation(records) for records in others]
print(f"deviation {deviation(best):.2g}; of 20 random motions {min(deviations):.2g} at least,", end=" ")
print(f"{np.median(deviations):.2g} in the median")
if deviation(best) > 0.8 * min(deviations):
    raise SystemExit("the motion is not better than the random ones")

figure, axes = plt.subplots(1, 2, figsize=(8.0, 3.0), sharey=True, layout="constrained")
pairs = (others[int(np.argmin(deviations))], "best random motion"), (best, "exciting motion")
for axis, (records, title) in zip(axes, pairs):
    axis.plot(times, records["q"], label=arm.joints)
    axis.set(xlabel="t (s)", ylabel="joint (rad)", title=title)
axes[1].legend()
figure.savefig("exciting_motion.png", dpi=100)
