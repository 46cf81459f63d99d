"""Leap of a quadruped with twelve motors: the optimiser decides which feet push, when they leave the ground and land.

Accelerations and the forces of the feet are controls, and torques follow by inverse dynamics. Each foot has a
complementarity constraint: its height or its normal force is zero. Friction is Coulomb's.
"""

import jax
import numpy as np
from matplotlib import pyplot as plt

import twistax as tx
from twistax.mechanics import ALIGNED, Drive, Link, Mechanism, SpatialInertia, frame_twist, given_forces, joints
from twistax.trajectory import Collocation, Contact, Friction, Problem

jax.config.update("jax_enable_x64", True)
FAR, HIGH, STAND, TIME, NODES = 0.4, 0.08, 0.3, 0.54, 19  # m, m: feet are that high halfway, m, s, nodes
body, dark = (tx.view.Box((0.46, 0.2, 0.1), color=(217, 119, 54)),), (62, 70, 84)
bones = [(tx.view.Capsule(r, 0.18, at=(0.0, 0.0, -0.09), color=dark),) for r in (0.025, 0.016)]
sole, bar = (tx.view.Sphere(0.02, color=(30, 33, 38)),), np.diag([2e-3, 2e-3, 2e-4])
trunk = SpatialInertia(mass=8.0, inertia=np.diag([0.06, 0.16, 0.19]))
hip = SpatialInertia(mass=0.2, inertia=np.diag([2e-4] * 3))
thigh = SpatialInertia(mass=0.6, center_of_mass=(0.0, 0.0, -0.08), inertia=bar)
shank = SpatialInertia(mass=0.2, center_of_mass=(0.0, 0.0, -0.08), inertia=0.4 * bar)
motor, down = Drive(effort=25.0, speed=15.0), tx.pose(position=[0.0, 0.0, -0.18])
X, Y = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)
links = [Link(joints.Free("trunk"), trunk, np.eye(4), shapes=body)]
for leg, x, y in (("fl", 0.2, 0.12), ("fr", 0.2, -0.12), ("rl", -0.2, 0.12), ("rr", -0.2, -0.12)):
    at = tx.pose(position=[x, y, 0.0])
    links += [
        Link(joints.Revolute(f"{leg}_roll", X), hip, at, "trunk", drive=motor),
        Link(joints.Revolute(f"{leg}_pitch", Y), thigh, np.eye(4), f"{leg}_roll", drive=motor, shapes=bones[0]),
        Link(joints.Revolute(f"{leg}_knee", Y), shank, down, f"{leg}_pitch", drive=motor, shapes=bones[1]),
        Link(joints.Fixed(f"{leg}_foot"), None, down, f"{leg}_knee", shapes=sole),
    ]
robot, feet = Mechanism(links), ["fl_foot", "fr_foot", "rl_foot", "rr_foot"]
height = {foot: robot.pose(foot)[2, 3] for foot in feet}
contact = given_forces(robot, feet, friction=0.6)
constraints = {}
for foot in feet:
    force, velocity = contact.controls[foot], frame_twist(robot, foot, axes=ALIGNED)
    friction = Friction(0.6, force=force[:2], velocity=velocity[:2])
    constraints[foot] = Contact(height[foot], force[2], friction, relaxation=1e-3)
system = robot.inverse_system(wrenches=contact.wrenches, constraints=constraints)
tau, forces, rest = system.output("tau"), tx.Concat(*contact.controls.values()), np.zeros(robot.dofs)
effort = 1e-2 * (tau @ tau) + 1e-4 * (system.qdd @ system.qdd) + 1e-4 * (forces @ forces)
bend, carried = np.arccos(STAND / 0.36), np.array([0.0, 0.0, 9.81 * 12.0 / 4.0])
standing = {"q": np.tile([0.0, bend, -2 * bend], 4), "qd": rest}
places = [{"trunk_position": tx.pose(position=[x, 0.0, STAND])} for x in (0.0, FAR)]
problem = Problem(
    tx.compile(system),
    tx.Minimize(running=effort),
    nodes=NODES,
    final_time=TIME,
    initial={**places[0], **standing},
    final={**places[1], "qd": rest},  # the joints are free: feet that must be on the ground have no slack
    at={NODES // 2: [height[foot] >= HIGH for foot in feet]},
    guess={"qdd": rest, **dict.fromkeys(contact.controls.values(), carried)},
    transcription=Collocation(tx.tableaus.RADAU_IIA1),
)
result = problem.solve(mesh_tolerance=np.inf)  # impacts take one interval: no mesh makes them exact
left = max(result.complementarity.values())
print(f"{result.status.name}, {result.iterations} iterations, cost {result.cost:.4f}, largest product left {left:.1e}")
if not result.solved:
    raise SystemExit(result.message)

figure, axes = plt.subplots(figsize=(7.0, 3.0), layout="constrained")
for k, foot in enumerate(feet):  # left and right curves may coincide
    normal, step = result.us[f"force_{foot}"][:, 2], TIME / (NODES - 1)
    print(f"{foot} flies for {step * (normal < 1.0).sum():.2f} s")
    axes.step(result.ts, np.append(normal, np.nan), f"C{k}", ls="--" if k % 2 else "-", where="post", label=foot)
axes.set(xlabel="t, s", ylabel="normal force, N")
axes.legend()
figure.savefig("leap.png", dpi=100)
result.show("leap.html", bodies=robot, trails=feet, seconds=4.0)
