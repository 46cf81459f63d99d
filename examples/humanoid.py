"""Whole-body control: a humanoid reaches with a hand, with its feet on the ground and its centre of mass above them."""

import jax
import numpy as np
from matplotlib import pyplot as plt

import twistax as tx
from twistax import mechanics
from twistax.mechanics import FrameTask, Link, LookAtTask, OrientationTask, PositionTask, StepStatus, joints
from twistax.view import Capsule, Scene, Sphere

jax.config.update("jax_enable_x64", True)


def limb(joint, mass, length, parent, at, radius=0.05):
    """A link that hangs down from its joint."""
    middle = (0.0, 0.0, -0.5 * length)
    inertia = mass * length**2 / 12.0 * np.diag([1.0, 1.0, 0.1])
    body = mechanics.SpatialInertia(mass=mass, center_of_mass=middle, inertia=inertia)
    return Link(joint, body, tx.pose(position=at), parent=parent, shapes=Capsule(radius, abs(length), at=middle))


ball, hinge = joints.Spherical, lambda name: joints.Revolute(name, (0.0, 1.0, 0.0))
links = [limb(joints.Free("pelvis"), 12.0, 0.1, None, (0.0, 0.0, 0.0), 0.1)]
links.append(limb(ball("chest"), 25.0, -0.45, "pelvis", (0.0, 0.0, 0.1), 0.12))
links.append(Link(joints.Fixed("eyes"), None, tx.pose(position=[0.1, 0.0, 0.65]), parent="chest", shapes=Sphere(0.12)))
for side, y in (("left", 1.0), ("right", -1.0)):
    links += [
        limb(ball(f"{side}_hip"), 8.0, 0.4, "pelvis", (0.0, 0.1 * y, -0.1)),
        limb(hinge(f"{side}_knee"), 4.0, 0.4, f"{side}_hip", (0.0, 0.0, -0.4)),
        limb(ball(f"{side}_foot"), 1.0, 0.05, f"{side}_knee", (0.0, 0.0, -0.4), 0.07),
        limb(ball(f"{side}_shoulder"), 2.5, 0.3, "chest", (0.0, 0.22 * y, 0.4)),
        limb(hinge(f"{side}_elbow"), 2.0, 0.3, f"{side}_shoulder", (0.0, 0.0, -0.3), 0.04),
        Link(joints.Fixed(f"{side}_hand"), None, tx.pose(position=[0.0, 0.0, -0.3]), parent=f"{side}_elbow"),
    ]
robot = mechanics.Mechanism(links)

# Bent knees and elbows; the feet are where they are then, turned so that they stand.
x = {f"{name}_position": np.eye(3) for name in robot.q if name not in ("q", "pelvis")}
angles = {"left_knee": 0.5, "right_knee": 0.5, "left_elbow": -0.6, "right_elbow": -0.6}
x |= {"q": np.array([angles[name] for name in robot.joints if name in angles]), "pelvis_position": np.eye(4)}
feet = {name: np.array(tx.lower(robot.pose(name))(0.0, x)) for name in ("left_foot", "right_foot")}
between = 0.5 * sum(T[:3, 3] for T in feet.values())

tasks = [
    PositionTask("right_hand", gain=20.0),
    LookAtTask("eyes", gain=5.0, weight=0.3),
    mechanics.PostureTask(x["q"], weight=0.1, gain=1.0),
    mechanics.CenterOfMassTask(between + [0.02, 0.0, 0.7], gain=5.0, weight=[3.0, 3.0, 0.1]),
    OrientationTask("pelvis", np.eye(3), gain=5.0, weight=0.1),
]
stand = [FrameTask(name, T) for name, T in feet.items()]
controller = mechanics.DifferentialController(robot, tasks, equalities=stand, dt=0.02, speed=4.0, regularization=1e-3)

ts, step, path, left = 0.02 * np.arange(200), None, [], []
for t in ts:
    hand = between + [0.35 + 0.1 * np.sin(2.0 * t), -0.3, 0.9 + 0.2 * np.cos(2.0 * t)]
    step = controller(x, {"right_hand_position": hand, "eyes_look_at": hand}, warm=step)
    if step.status != StepStatus.SOLVED:
        raise SystemExit(f"the controller ended with {StepStatus(int(step.status)).name}")
    path.append(x)
    left.append([1e3 * float(np.linalg.norm(e)) for e in (step.errors[0], step.errors[3][:2], step.errors[5])])
    x = step.x

print(
    "hand, centre of mass, left foot: largest errors of the last second (mm):", np.round(np.max(left[-50:], axis=0), 2)
)
if np.max(left[-50:], axis=0)[2] > 0.1 or np.max(left[-50:]) > 50.0:
    raise SystemExit("a foot moves, or the hand does not follow")
xs = {name: np.stack([p[name] for p in path]) for name in path[0]}
Scene(ts, tuple(robot.bodies_in_view(xs, {}))).save("humanoid.html")
figure, axes = plt.subplots(figsize=(5.0, 3.0), layout="constrained")
axes.semilogy(ts, np.array(left) + 1e-6, label=["hand", "centre of mass", "left foot"])
axes.set(xlabel="time (s)", ylabel="error (mm)")
axes.legend()
figure.savefig("humanoid.png", dpi=100)
