"""Exciting motion: the motion within limits from which the masses of an arm are identified best."""

import jax
import numpy as np
from matplotlib import pyplot as plt

import twistax as tx
from twistax import mechanics
from twistax.mechanics import Drive, Link, SpatialInertia, joints

jax.config.update("jax_enable_x64", True)
NOISE, SECONDS, NODES, RATE = 0.2, 2.0, 41, 100  # of the torques, N m; of a motion; of the optimisation; samples, Hz


def link(name, mass, effort, x):
    body = SpatialInertia(mass=mass, center_of_mass=(0.2, 0.02, 0.0), inertia=mass * np.diag([0.002, 0.02, 0.02]))
    drive = Drive(lower=-1.5, upper=1.5, speed=4.0, effort=effort)
    return Link(joints.Revolute(name, (0.0, 1.0, 0.0)), body, tx.pose(position=[x, 0.0, 0.0]), drive=drive)


arm = mechanics.Chain([link("shoulder", 3.0, 60.0, 0.0), link("elbow", 1.5, 15.0, 0.4)])
base = mechanics.base_parameters(arm)
print(f"{base.rank} combinations are identifiable: {', '.join(base.names)}")

# The information about them is the integral of Y^T Y. Its lower half is a state.
q, qd, qdd = arm.q, arm.qd, tx.Control("qdd", (2,))
Y = mechanics.inverse_dynamics_regressor(arm, qdd=qdd).matrix[:, list(base.columns)]
pairs = [(i, j) for i in range(base.rank) for j in range(i + 1)]
info = tx.State("info", (len(pairs),))
full = tx.Stack(*(tx.Concat(*(info[pairs.index((max(i, j), min(i, j)))] for j in range(6))) for i in range(6)))
variances = tx.linalg.Trace(tx.linalg.Inv(full))  # their sum
tau, most = mechanics.inverse_dynamics(arm, qdd=qdd), arm.motors(arm.joints).max
growth = tx.Concat(*(tx.linalg.Dot(Y[:, i], Y[:, j]) for i, j in pairs))
dynamics = tx.compile(tx.System(rates={q: qd, qd: qdd, info: growth}, constraints=[tx.Abs(tau / most) <= np.ones(2)]))
torques = jax.jit(jax.vmap(lambda x, u: tx.lower(tau / most)(0.0, x, u)))
rates = jax.jit(jax.vmap(lambda x, u: dynamics(0.0, x, u)["info"]))


def sines(seed):
    """A random sum of sines between rests, within the limits of positions, speeds and torques."""
    rng, t = np.random.default_rng(seed), np.linspace(0.0, SECONDS, int(SECONDS * RATE) + 1)[:, None]
    wave = sum(rng.normal(size=2) * np.sin(k * np.pi * t / SECONDS + rng.uniform(0.0, 7.0, 2)) for k in (1, 2, 3, 5))
    wave = wave * np.sin(np.pi * t / SECONDS) ** 2
    for size in np.linspace(1.5, 0.01, 150) / np.abs(wave).max():
        qd = np.gradient(size * wave, 1.0 / RATE, axis=0)
        x = {"q": size * wave, "qd": qd, "info": np.zeros((len(t), len(pairs)))}
        u = {"qdd": np.gradient(qd, 1.0 / RATE, axis=0)}
        if np.abs(qd).max() < 4.0 and np.abs(torques(x, u)).max() < 1.0:
            return x | {"info": np.cumsum(rates(x, u), axis=0) / RATE}, u
    raise SystemExit("no size is within the limits")


def deviation(info):
    """The root mean square deviation of the combinations, of samples at the rate."""
    F = np.zeros((6, 6))
    F[tuple(np.transpose(pairs))] = info
    return NOISE * np.sqrt(np.trace(np.linalg.inv(F + np.tril(F, -1).T)) / 6 / RATE)


naive = [sines(seed) for seed in range(20)]
deviations = [deviation(x["info"][-1]) for x, _ in naive]
x, u = naive[int(np.argmin(deviations))]
step = int(SECONDS * RATE) // (NODES - 1)
guess = {name: a[::step] for name, a in x.items()} | {"qdd": u["qdd"][:-1:step]}
rest = {"q": np.zeros(2), "qd": np.zeros(2)}
ends = {"initial": {**rest, "info": np.zeros(len(pairs))}, "final": rest, "final_time": SECONDS, "nodes": NODES}
result = tx.trajectory.Problem(dynamics, tx.Minimize(tx.Log(variances)), **ends).solve(guess=guess)
best, typical = deviation(result.xs["info"][-1]), np.median(deviations)
print(f"deviation {best:.2g}; of 20 random sums of sines {min(deviations):.2g} at least, {typical:.2g} in the median")
if not result.solved or best > 0.6 * min(deviations):
    raise SystemExit("the motion is not better than the random ones")

figure, axes = plt.subplots(1, 2, figsize=(8.0, 3.0), sharey=True, layout="constrained")
times = np.linspace(0.0, SECONDS, len(x["q"])), result.ts
for axis, ts, motion, title in zip(axes, times, (x, result.xs), ("best random motion", "exciting motion")):
    axis.plot(ts, motion["q"], label=arm.joints)
    axis.set(xlabel="t (s)", ylabel="joint (rad)", title=title)
axes[1].legend()
figure.savefig("exciting_motion.png", dpi=100)
