"""Fastest move of a Panda: by forward dynamics with torques as controls, and by inverse dynamics with accelerations.

Both have the speed and torque limits of the URDF and the same optimum. Inverse dynamics take fewer iterations.
"""

from pathlib import Path

import jax
import numpy as np
from matplotlib import pyplot as plt

import twistax as tx
from twistax.mechanics import load

jax.config.update("jax_enable_x64", True)
NODES = 21

arm = load(Path(__file__).with_name("panda.urdf"))
rest = np.zeros(arm.dofs)
start = {"q": np.array([0.0, -0.3, 0.0, -2.2, 0.0, 2.0, 0.8]), "qd": rest}
goal = {"q": np.array([1.2, 0.5, -0.3, -1.2, 0.4, 1.6, 0.2]), "qd": rest}
euler = {"method": tx.RKMK(tx.tableaus.EULER), "substeps": 1}  # rates once an interval: both forms mean the same
ends = {"initial": start, "final": goal, "nodes": NODES, "final_time": (0.2, 3.0)}

results = {}
systems = {"forward": arm.system(), "inverse": arm.inverse_system()}
for form, system in systems.items():
    problem = tx.trajectory.Problem(tx.compile(system), tx.Minimize(tx.Time()), **ends, **euler)
    results[form] = result = problem.solve(max_iterations=500)
    print(f"{form} dynamics: {result.final_time:.6f} s, {result.iterations} iterations")

times = [float(result.final_time) for result in results.values()]
print("the optimum is the same to 1e-6" if abs(times[0] / times[1] - 1.0) < 1e-6 else f"they differ: {times}")

inverse = tx.compile(systems["inverse"])
nodes = range(NODES - 1)
motion, commands = results["inverse"].xs, results["inverse"].us["qdd"]
outputs = [inverse.outputs(0.0, {name: a[k] for name, a in motion.items()}, {"qdd": commands[k]}) for k in nodes]
torques = np.array([values["tau"] for values in outputs])
limits = arm.motors(arm.driven).max
print(f"torques reach {100 * np.abs(torques / limits).max():.0f} % of their limits, ", end="")
print(f"speeds {100 * np.abs(motion['qd'] / arm.qd.max).max():.0f} %")

figure, (left, right) = plt.subplots(1, 2, figsize=(9.0, 3.0), layout="constrained")
ts = results["inverse"].ts
left.plot(ts, motion["qd"] / arm.qd.max)
left.set(xlabel="t, s", ylabel="speed, share of its limit")
right.step(ts[:-1], torques / limits, where="post", label=arm.joints)
right.set(xlabel="t, s", ylabel="torque, share of its limit")
right.legend(fontsize="x-small", ncols=2)
figure.savefig("fastest_move.png", dpi=100)
