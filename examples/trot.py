"""Trot of a quadruped: three steps on diagonal pairs of feet, planned by inverse dynamics with contact forces.

Accelerations and the forces of the feet are controls. The six degrees of freedom of the trunk have no motor: their
forces are constrained to zero.
"""

import jax
import numpy as np
from matplotlib import pyplot as plt

import twistax as tx
from twistax.mechanics import Drive, Link, Mechanism, SpatialInertia, given_forces, joints

jax.config.update("jax_enable_x64", True)
STRIDE, PERIOD, HEIGHT, NODES = 0.15, 0.3, 0.3, 11  # m, s, m, of each step
bar = np.diag([2e-3, 2e-3, 2e-4])
trunk = SpatialInertia(mass=8.0, inertia=np.diag([0.06, 0.16, 0.19]))
hip = SpatialInertia(mass=0.2, inertia=np.diag([2e-4] * 3))
thigh = SpatialInertia(mass=0.6, center_of_mass=(0.0, 0.0, -0.08), inertia=bar)
shank = SpatialInertia(mass=0.2, center_of_mass=(0.0, 0.0, -0.08), inertia=0.4 * bar)
motor, down = Drive(effort=25.0, speed=15.0), tx.pose(position=[0.0, 0.0, -0.18])
links = [Link(joints.Free("trunk"), trunk, np.eye(4))]
for leg, x, y in (("fl", 0.2, 0.12), ("fr", 0.2, -0.12), ("rl", -0.2, 0.12), ("rr", -0.2, -0.12)):
    at = tx.pose(position=[x, y, 0.0])
    links += [
        Link(joints.Revolute(f"{leg}_roll", (1.0, 0.0, 0.0)), hip, at, parent="trunk", drive=motor),
        Link(joints.Revolute(f"{leg}_pitch", (0.0, 1.0, 0.0)), thigh, np.eye(4), parent=f"{leg}_roll", drive=motor),
        Link(joints.Revolute(f"{leg}_knee", (0.0, 1.0, 0.0)), shank, down, parent=f"{leg}_pitch", drive=motor),
        Link(joints.Fixed(f"{leg}_foot"), None, down, parent=f"{leg}_knee"),
    ]
robot, feet = Mechanism(links), ["fl_foot", "fr_foot", "rl_foot", "rr_foot"]
height = {foot: robot.pose(foot)[2, 3] for foot in feet}
bend, rest = np.arccos(HEIGHT / 0.36), np.zeros(robot.dofs)


def standing(x):
    return {"q": np.tile([0.0, bend, -2 * bend], 4), "trunk_position": tx.pose(position=[x, 0.0, HEIGHT]), "qd": rest}


def stance(pair):
    contact = given_forces(robot, pair, friction=0.6)
    system = robot.inverse_system(wrenches=contact.wrenches, constraints={**contact.cones, **contact.at_rest})
    forces = tx.Concat(*contact.controls.values())
    torques, qdd = system.output("tau"), system.qdd
    effort = 1e-2 * (torques @ torques) + 1e-3 * (qdd @ qdd) + 1e-4 * (forces @ forces)
    guess = {"qdd": rest, **{force: np.array([0.0, 0.0, 56.0]) for force in contact.controls.values()}}
    return {"dynamics": tx.compile(system), "objective": tx.Minimize(running=effort), "guess": guess}


pairs = [("fl_foot", "rr_foot"), ("fr_foot", "rl_foot"), ("fl_foot", "rr_foot")]
stances = {pair: stance(pair) for pair in pairs[:2]}
steps = []
for k, pair in enumerate(pairs):
    swing = [height[foot] for foot in feet if foot not in pair]
    ends = {"final": standing(2 * STRIDE) if k == 2 else [z == 0.0 for z in swing]}
    ends |= {"initial": standing(0.0)} if k == 0 else {}
    mesh = {"nodes": NODES, "final_time": PERIOD, "substeps": 1, "controls": tx.trajectory.Linear()}
    clear = {NODES // 2: [z >= 0.04 for z in swing]}  # halfway feet are 4 cm high
    steps.append(tx.trajectory.Phase(**stances[pair], **mesh, **ends, at=clear, name=f"step {k + 1}"))
result = tx.trajectory.Problem(steps).solve()
print(f"{result.status.name}, {result.iterations} iterations")
distance = result.phases[-1].xs["trunk_position"][-1][0, 3]
print(f"the trunk moves by {distance:.2f} m in {3 * PERIOD:.1f} s")
if result.status is not tx.trajectory.Status.SOLVED:
    raise SystemExit(result.message)

figure, axes = plt.subplots(figsize=(7.0, 3.0), layout="constrained")
for k, (step, pair) in enumerate(zip(result.phases, pairs)):
    for foot in pair:
        axes.plot(step.ts, step.us[f"force_{foot}"][:, 2], f"C{feet.index(foot)}", label=foot if k < 2 else None)
axes.set(xlabel="t, s", ylabel="vertical force of a foot, N")
axes.legend()
figure.savefig("trot.png", dpi=100)
