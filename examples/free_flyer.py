"""Free-flyer docking: the fastest motion of a small robot in a space station to a dock, rotated by ninety degrees.

The pose is one state on SE(3). The limits of the jets are limits of the control, in body axes.
"""

import jax
import numpy as np
from matplotlib import pyplot as plt

import twistax as tx

jax.config.update("jax_enable_x64", True)

M = np.diag([12.0, 12.0, 12.0, 0.18, 0.20, 0.22])  # spatial inertia, kg and kg m2
most = np.array([0.6, 0.3, 0.3, 0.02, 0.02, 0.02])  # N and N m
g = tx.State("g", group=tx.SE3, kind=tx.kinds.Pose("station", "flyer"))
V = tx.State("V", shape=(6,), kind=tx.Twist("flyer"))
F = tx.Control("F", shape=(6,), min=-most, max=most, kind=tx.Wrench("flyer"))
flyer = tx.compile(tx.System(rates={g: V, V: tx.linalg.Solve(M, F - tx.lie.AdjointDual(V, M @ V))}))

dock = tx.pose(position=[2.0, 1.0, 0.0], euler=[0.0, 0.0, np.pi / 2])
problem = tx.trajectory.Problem(
    flyer,
    tx.Minimize(tx.Time()),
    nodes=21,
    final_time=(5.0, 60.0),
    initial={g: tx.pose(), V: np.zeros(6)},
    final={g: dock, V: np.zeros(6)},
)
result = problem.solve()
print(result.message)
flown = tx.integrate(flyer, {"g": tx.pose(), "V": np.zeros(6)}, t1=result.final_time, rtol=1e-9, u=result.controls)
miss = tx.SE3.difference(dock, np.asarray(flown.xs["g"][-1]))  # linear part first
print(f"docked after {result.final_time:.2f} s; a rollout misses by {1e3 * np.linalg.norm(miss[:3]):.1f} mm", end=" ")
print(f"and {np.rad2deg(np.linalg.norm(miss[3:])):.2f} degrees")

poses = np.asarray(result.dense.xs["g"])
figure, (left, right) = plt.subplots(1, 2, figsize=(8.0, 3.2), layout="constrained")
left.plot(poses[:, 0, 3], poses[:, 1, 3])
some = poses[:: len(poses) // 12]
left.quiver(some[:, 0, 3], some[:, 1, 3], some[:, 0, 0], some[:, 1, 0], color="C1", scale=18.0)
left.set(xlabel="x, m", ylabel="y, m", aspect="equal", title="path, and where its front points")
share = np.asarray(result.us["F"])[:, [0, 1, 5]] / most[[0, 1, 5]]
right.step(result.ts[:-1], share, where="post", label=["forward", "sideways", "turn"])
right.set(xlabel="time, s", ylabel="share of the jets")
right.legend(frameon=False, loc="lower left")
figure.savefig("free_flyer.png", dpi=100)
if not result.solved:
    raise SystemExit("the solve found no optimum")
