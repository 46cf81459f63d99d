"""Obstacle avoidance: a differential controller moves an arm between two shelves, over them and back."""

from pathlib import Path

import jax
import numpy as np
from matplotlib import pyplot as plt

from twistax.mechanics import DifferentialController, PositionTask, PostureTask, StepStatus, clearances, load
from twistax.view import Box, Capsule, Scene, Sphere

jax.config.update("jax_enable_x64", True)

arm = load(Path(__file__).with_name("panda.urdf"))
boards = {f"board{k}": Box((0.4, 1.2, 0.03), at=(0.65, 0.0, z)) for k, z in enumerate((0.25, 0.7))}
solids = {"link5": Capsule(0.06, 0.15, at=(0.0, 0.0, -0.1)), "flange": Sphere(0.06)}
distances = clearances(arm, solids, boards, ignored=[("link5", "flange")])

home = np.array([0.0, -0.8, 0.0, -2.4, 0.0, 2.0, 0.8])
controller = DifferentialController(
    arm,
    [PositionTask("flange", gain=8.0), PostureTask(home, weight=0.01, gain=1.0)],
    dt=0.01,
    speed=1.5,
    constraints={name: distance >= 0.02 for name, distance in distances.items()},
)

# Between the boards, out again, over them, and a point within the upper board, which it stops above.
points = [(0.6, -0.2, 0.45), (0.35, 0.0, 0.5), (0.45, 0.2, 0.95), (0.55, 0.2, 0.7)]
x, step, path, errors, gaps = {"q": home}, None, [], [], []
for k in range(800):
    step = controller(x, {"flange_position": np.array(points[k // 200])}, warm=step)
    if step.status != StepStatus.SOLVED:
        raise SystemExit(f"the controller ended with {StepStatus(int(step.status)).name}")
    path.append(x["q"])
    errors.append(np.linalg.norm(step.errors[0]))
    gaps.append(0.02 - float(np.max(step.constraints)))
    x = step.x

ends = [errors[200 * k - 1] for k in range(1, 5)]
print("left to the points (mm):", *(f"{1e3 * e:.2f}" for e in ends))
print(f"the arm stays {1e3 * min(gaps):.1f} mm from the boards, where 20 mm are required")
if max(ends[:3]) > 2e-3 or min(gaps) < 0.018:
    raise SystemExit("a point is not reached, or the arm touches a board")

ts = 0.01 * np.arange(800)
Scene(ts, tuple(arm.bodies_in_view({"q": np.array(path)}, {})), shapes=tuple(boards.values())).save("shelves.html")
figure, axes = plt.subplots(figsize=(5.0, 3.0), layout="constrained")
axes.semilogy(ts, 1e3 * np.array(errors), label="left to the point")
axes.semilogy(ts, 1e3 * np.array(gaps), label="least distance")
axes.axhline(20.0, color="gray", linestyle="--")
axes.set(xlabel="time (s)", ylabel="mm")
axes.legend()
figure.savefig("shelves.png", dpi=100)
