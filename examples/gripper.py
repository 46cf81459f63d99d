"""Inverse kinematics: a gripper is attached to an arm, and its tip draws a circle above a table."""

from pathlib import Path

import jax
import numpy as np
from matplotlib import pyplot as plt

import twistax as tx
from twistax.mechanics import Link, Mechanism, ReachStatus, SpatialInertia, joints, load, reach, signed_distance
from twistax.view import Box, Capsule

jax.config.update("jax_enable_x64", True)

# The gripper: two fingers that slide, and a tip between them.
finger = SpatialInertia(mass=0.05, center_of_mass=(0.0, 0.0, 0.02), inertia=1e-5 * np.eye(3))


def slide(name, y):
    return Link(joints.Prismatic(name, (0.0, y, 0.0)), finger, tx.pose(position=[0.0, 0.0, 0.06]))


tip = Link(joints.Fixed("tip"), None, tx.pose(position=[0.0, 0.0, 0.1]))
gripper = Mechanism([slide("left", 1.0), slide("right", -1.0), tip], base="hand")
arm = load(Path(__file__).with_name("panda.urdf")).attach(gripper, "flange")
arm = arm.lock({"left": 0.02, "right": 0.02})

# The tip points down on a circle of 15 cm.
angle = np.linspace(0.0, 2.0 * np.pi, 121)
targets = np.tile(np.diag([1.0, -1.0, -1.0, 1.0]), (len(angle), 1, 1))
targets[:, :3, 3] = np.stack([0.5 + 0.15 * np.cos(angle), 0.15 * np.sin(angle), np.full_like(angle, 0.15)], axis=1)
home = {"q": np.array([0.0, 0.3, 0.0, -2.0, 0.0, 2.3, 0.8])}
result = reach(arm, {"tip": targets}, start=home)

# How far the hand stays from the table.
hand, table = Capsule(0.05, 0.05), Box((0.8, 0.8, 0.05), at=(0.5, 0.0, 0.0))
clear = tx.lower(signed_distance(hand, table, arm.pose("hand")))
distance = jax.jit(jax.vmap(lambda q: clear(0.0, {"q": q})))(result.x["q"])

reached = np.mean(np.asarray(result.status) == ReachStatus.REACHED)
print(f"{reached:.0%} of {len(angle)} poses reached, to {1e6 * float(np.max(result.distance)):.2f} um")
print(f"the hand stays {100.0 * float(np.min(distance)):.1f} cm from the table")
if reached < 1.0 or np.min(distance) < 0.05:
    raise SystemExit("a pose is not reached, or the arm is too close to the table")

figure, axes = plt.subplots(figsize=(5.0, 3.0), layout="constrained")
axes.plot(np.rad2deg(angle), np.asarray(result.x["q"]), label=arm.joints)
axes.set(xlabel="angle on the circle (deg)", ylabel="joints (rad)")
axes.legend(fontsize=7, ncols=2)
figure.savefig("gripper.png", dpi=100)
