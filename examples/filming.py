"""Camera constraint: a quadrotor keeps a runner in the view cone of its camera, with limits on their distance.

The problem is the cinematic view planning of OpenSCvx's gallery. The camera looks along the body's x axis, and the
rotors push along z.
"""

import numpy as np
from matplotlib import pyplot as plt

import twistax as tx

HALF, NEAR, FAR, LAST = np.deg2rad(25.0), 3.0, 6.0, 6.0  # half angle of the cone, m, m, s
GRAVITY = np.array([0.0, 0.0, -9.81])  # m/s2

g, v = tx.State("g", group=tx.SE3), tx.State("v", shape=(3,))  # pose, velocity in body axes
turn = tx.Control("turn", shape=(3,), min=-3.0, max=3.0, guess=np.zeros(3))  # rad/s
push = tx.Control("push", min=2.0, max=20.0, guess=9.81)  # N per kg
t = tx.Time()

runner = tx.Concat(4.0 * tx.Cos(0.6 * t), 4.0 * tx.Sin(0.6 * t), 1.0)  # a circle in 10.5 s
R, place = g[:3, :3], g[:3, 3]
sight = R.T @ (runner - place)  # from the camera to the runner, in body axes
film = tx.System(
    rates={
        g: tx.lie.twist(linear=v, angular=turn),
        v: R.T @ GRAVITY + tx.Concat(0.0, 0.0, push) - tx.linalg.Cross(turn, v),
    },
    constraints={
        "in view": tx.linalg.Norm(sight) <= sight[0] / np.cos(HALF),
        "not too near": sight @ sight >= NEAR**2,
        "near enough": tx.linalg.Norm(sight) <= FAR,
    },
)
shake = 10.0 * turn @ turn + (push - 9.81) ** 2
start = tx.pose(position=[0.0, 0.0, 1.5])
problem = tx.trajectory.Problem(
    tx.compile(film),
    tx.Minimize(running=shake),
    nodes=31,
    final_time=LAST,
    initial={g: start, v: np.zeros(3)},
    guess={g: start},
    controls=tx.trajectory.Linear(),
)
result = problem.solve(between=1e-4)
print(result.message)

along = result.replay(steps=20)
times, poses = along.ts, along.xs["g"]
seen = np.stack([4.0 * np.cos(0.6 * times), 4.0 * np.sin(0.6 * times), np.ones_like(times)], axis=1)
away = np.einsum("kji,kj->ki", poses[:, :3, :3], seen - poses[:, :3, 3])
distance = np.linalg.norm(away, axis=1)
angle = np.rad2deg(np.arccos(away[:, 0] / distance))
print(f"the runner is {distance.min():.2f} to {distance.max():.2f} m away, at most {angle.max():.2f} deg off the axis")
print(f"the quadrotor moves by {np.ptp(poses[:, :3, 3], axis=0).round(2)} m, cost {result.cost:.3f}")
for name, size in result.between_nodes.items():
    if size > 0.0:
        print(f"between nodes '{name}' is exceeded by {size:.1e}, in m or m2")
if (
    not result.solved
    or angle.max() > np.rad2deg(HALF) + 0.1
    or distance.min() < NEAR - 1e-3
    or distance.max() > FAR + 1e-3
):
    raise SystemExit("the runner leaves the view of the camera")

figure, both = plt.subplots(1, 2, figsize=(8.0, 3.0), layout="constrained")
curves = ((angle, "angle off the axis, deg", [np.rad2deg(HALF)]), (distance, "distance, m", [NEAR, FAR]))
for axes, (values, name, limits) in zip(both, curves):
    axes.plot(times, values)
    for limit in limits:
        axes.axhline(limit, color="0.6", linestyle="--", linewidth=0.9, label=f"limit {limit:.3g}")
    axes.set(xlabel="time, s", ylabel=name)
    axes.legend(fontsize="small", loc="upper left", bbox_to_anchor=(1.0, 1.0))
figure.savefig("filming.png", dpi=100)
