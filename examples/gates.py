"""Race through gates: a point mass flies through ten gates and back in minimum time, as in OpenSCvx's drone races.

Each gate is a constraint at a node. The lengths of intervals are free, so the times of passage are unknowns.
"""

import numpy as np
from matplotlib import pyplot as plt

import twistax as tx

GATES = np.array(
    [
        [59.4, 0.0, 20.0],
        [93.0, -23.8, 25.5],
        [93.0, -29.3, 20.0],
        [93.0, -23.8, 20.0],
        [130.2, -23.8, 20.0],
        [152.4, -73.2, 20.0],
        [93.0, -75.1, 20.0],
        [93.0, -68.6, 20.0],
        [59.4, -81.4, 20.0],
        [22.3, -42.7, 20.0],
    ]
)  # m
START, RADIUS, BETWEEN = np.array([10.0, 0.0, 20.0]), 1.0, 3  # m, m, intervals from gate to gate

p, v = tx.State("p", shape=(3,)), tx.State("v", shape=(3,))
push = tx.Control("push", shape=(3,), guess=[0.0, 0.0, 9.81])  # N per kg
system = tx.System(
    rates={p: v, v: push - np.array([0.0, 0.0, 9.81])},
    constraints={"thrust": tx.linalg.Norm(push) <= 41.0, "floor": p[2] >= 15.0},
)

stations = np.concatenate([[START], GATES, [START]])
count = BETWEEN * (len(stations) - 1) + 1
through = {BETWEEN * (k + 1): tx.linalg.Norm(p - gate) <= RADIUS for k, gate in enumerate(GATES)}
straight = np.stack([np.interp(np.arange(count) / BETWEEN, np.arange(len(stations)), a) for a in stations.T], axis=1)
problem = tx.trajectory.Problem(
    tx.compile(system),
    tx.Minimize(tx.Time()),
    nodes=tx.trajectory.Mesh(count, free=(0.05, 5.0)),
    substeps=4,
    final_time=(5.0, 60.0),
    initial={p: START, v: np.zeros(3)},
    final={p: START},
    at=through,
    guess={p: straight},
)
result = problem.solve()
print(result.message)
print(f"{result.final_time:.3f} s, at most {np.linalg.norm(result.xs['v'], axis=1).max():.1f} m/s")
for node, gate in zip(through, GATES):
    away = np.linalg.norm(result.xs["p"][node] - gate)
    print(f"{result.ts[node]:7.3f} s: {away:.2f} m from the middle of the gate at {gate}")
print(f"limits are exceeded between nodes by {max(result.between_nodes.values()):.1e}")
if not result.solved:
    raise SystemExit("the solve found no optimum")

path = np.asarray(result.dense.xs["p"])
figure, axes = plt.subplots(figsize=(6.0, 3.6), layout="constrained")
speed = np.linalg.norm(result.dense.xs["v"], axis=1)
colored = axes.scatter(path[:, 0], path[:, 1], c=speed, s=3)
axes.plot(GATES[:, 0], GATES[:, 1], "kx", label="gates")
axes.set(xlabel="x, m", ylabel="y, m", aspect="equal")
axes.legend(frameon=False)
figure.colorbar(colored, label="speed, m/s")
figure.savefig("gates.png", dpi=100)
