"""Quadruped on soft ground: four legs with compliant contact and friction, pushed from the side."""

import jax
import numpy as np
from matplotlib import pyplot as plt

import twistax as tx
from twistax.mechanics import Drive, Ground, Link, Mechanism, SpatialInertia, joints

jax.config.update("jax_enable_x64", True)

trunk = SpatialInertia(mass=8.0, inertia=np.diag([0.06, 0.16, 0.19]))
leg = SpatialInertia(mass=0.8, center_of_mass=(0.0, 0.0, -0.15), inertia=np.diag([6e-3, 6e-3, 4e-4]))
# What the parts look like.
body, leg_color = (tx.view.Box((0.5, 0.2, 0.11), color=(217, 119, 54)),), (62, 70, 84)
thigh = (tx.view.Capsule(0.032, 0.1, at=(0.0, 0.0, -0.07), color=leg_color),)
shank = (tx.view.Capsule(0.02, 0.14, at=(0.0, 0.0, -0.2), color=(120, 130, 145)),)
foot = (tx.view.Sphere(0.028, color=(30, 33, 38)),)
links, feet = [Link(joints.Free("trunk"), trunk, np.eye(4), shapes=body)], []
for name, x, y in (("fl", 0.2, 0.12), ("fr", 0.2, -0.12), ("rl", -0.2, 0.12), ("rr", -0.2, -0.12)):
    at, below, up = tx.pose(position=[x, y, 0.0]), tx.pose(position=[0.0, 0.0, -0.3]), (0.0, 0.0, 1.0)
    spring = Drive(stiffness=150.0, damping=4.0, armature=0.02)  # a joint that holds its angle
    slide = Drive(stiffness=4e3, damping=150.0, armature=0.05)
    links += [
        Link(joints.Revolute(f"{name}_roll", (1.0, 0.0, 0.0)), leg, at, "trunk", drive=spring, shapes=thigh),
        Link(joints.Prismatic(f"{name}_shank", up), None, np.eye(4), f"{name}_roll", drive=slide, shapes=shank),
        Link(joints.Fixed(f"{name}_foot"), None, below, parent=f"{name}_shank", shapes=foot),
    ]
    feet.append(f"{name}_foot")
robot = Mechanism(links, driven=[])
ground = Ground(stiffness=1e4, damping=0.5, friction=0.7, sharpness=1e-4, slip=0.02)
contact = ground.wrenches(robot, feet)
# A push of about a tenth of a second, along the world's y.
T = robot.q["trunk"]
push = 30.0 * tx.Exp(-(((tx.Time() - 0.5) / 0.05) ** 2))
force = tx.lie.wrench(force=T[:3, :3].T @ tx.Concat(0.0, push, 0.0), torque=np.zeros(3))
normal = tx.Concat(*((robot.pose(foot)[:3, :3] @ contact[foot][:3])[2] for foot in feet))
outputs = {"push": tx.Concat(0.0, push, 0.0), "trunk": T[:3, 3], "roll": tx.lie.SO3Log(T[:3, :3])[0], "normal": normal}
dynamics = tx.compile(robot.system(wrenches={**contact, "trunk": force}, outputs=outputs))
start = {"q": np.zeros(8), "trunk_position": tx.pose(position=[0.0, 0.0, 0.3]), "qd": np.zeros(14)}
times = np.linspace(0.0, 1.0, 101)
sol = tx.integrate(dynamics, start, t1=1.0, dt=2.5e-4, save_at=times)
found = jax.vmap(dynamics.outputs)(sol.ts, sol.xs)
weight = 9.81 * (8.0 + 4 * 0.8)
carried = np.asarray(found["normal"]).sum(axis=1)
print(f"standing, the feet carry {carried[39]:.1f} N of the weight's {weight:.1f} N")
print(f"pushed, the trunk moves by {np.abs(found['trunk'][:, 1]).max() * 1e3:.0f} mm to the side")
print(
    f"after a second it stands {found['trunk'][-1, 2]:.3f} m high and rolls by {np.degrees(found['roll'][-1]):.1f} deg"
)
if abs(carried[39] - weight) > 0.05 * weight or abs(np.degrees(found["roll"][-1])) > 10.0:
    raise SystemExit("the feet do not carry the weight, or the robot falls")

figure, (left, right) = plt.subplots(1, 2, figsize=(9.0, 3.0), layout="constrained")
left.plot(times, found["trunk"][:, 1] * 1e3)
left.set(xlabel="t (s)", ylabel="lateral position of the trunk (mm)")
for k, foot in enumerate(feet):  # on each side the curves of both feet coincide
    right.plot(times, found["normal"][:, k], ("-", "-", "--", "--")[k], label=foot)
right.set(xlabel="t (s)", ylabel="normal force on a foot (N)")
right.legend()
figure.savefig("quadruped.png", dpi=100)
arrow = {"push": tx.view.Arrow("trunk", world=True, scale=0.01)}
sol.show("quadruped.html", bodies=robot, arrows=arrow, trails=[], caption=["roll"], seconds=6.0)
