"""Reaction wheels: a satellite with an antenna on a ball joint turns to its target, with zero total momentum."""

import jax
import numpy as np
from matplotlib import pyplot as plt

import twistax as tx
from twistax.mechanics import Drive, Link, Mechanism, SpatialInertia, centroidal_momentum, joints

jax.config.update("jax_enable_x64", True)

hub = SpatialInertia(mass=40.0, inertia=np.diag([4.0, 5.0, 3.0]))
dish = SpatialInertia(mass=3.0, center_of_mass=(0.0, 0.0, 0.4), inertia=np.diag([0.3, 0.3, 0.2]))
links = [Link(joints.Free("hub"), hub, np.eye(4))]
for name, axis in zip("xyz", np.eye(3), strict=True):
    wheel = SpatialInertia(mass=1.0, inertia=0.01 * np.eye(3) + 0.01 * np.outer(axis, axis))
    links.append(Link(joints.Revolute(f"wheel_{name}", axis), wheel, tx.pose(position=0.2 * axis), parent="hub"))
ball, hinge = joints.Spherical("ball"), Drive(stiffness=2.0, damping=0.4)
links.append(
    Link(
        ball,
        dish,
        tx.pose(position=[0.0, 0.0, 0.5]),
        parent="hub",
        name="dish",
        drive=Drive(stiffness=2.0, damping=0.4),
    )
)
wheels = ["wheel_x", "wheel_y", "wheel_z"]
satellite = Mechanism(links, gravity=(0.0, 0.0, 0.0), driven=wheels)

# Wheels push against what turns the hub away from where it shall look.
goal = tx.pose(euler=[0.6, -0.4, 0.9])[:3, :3]
T = satellite.q["hub"]
error = tx.lie.SO3Log(goal.T @ T[:3, :3])
torque = 1.5 * error + 5.0 * satellite.qd[3:6]
forces = tx.Concat(np.zeros(6), torque, np.zeros(3))
momentum = centroidal_momentum(satellite)
outputs = {"off": tx.linalg.Norm(error), "L": momentum[3:], "dish": tx.lie.SO3Log(satellite.q["ball"])}
dynamics = tx.compile(satellite.system(controls=[], forces=forces, outputs=outputs))
start = {"q": np.zeros(3), "hub_position": np.eye(4), "ball_position": np.eye(3), "qd": np.zeros(12)}
times = np.linspace(0.0, 30.0, 151)
sol = tx.integrate(dynamics, start, t1=30.0, dt=0.02, save_at=times)
found = jax.vmap(dynamics.outputs)(sol.ts, sol.xs)
off, momenta = np.degrees(found["off"]), np.linalg.norm(found["L"], axis=1)
print(f"off its goal: {off[0]:.1f} deg at the start, {off[-1]:.3f} deg after 30 s")
print(
    f"largest momentum: {momenta.max():.1e} N m s; wheels turn at most {np.abs(sol.xs['qd'][:, 6:9]).max():.1f} rad/s"
)
print(f"the dish leans by at most {np.degrees(np.linalg.norm(found['dish'], axis=1).max()):.1f} deg")
if off[-1] > 1.0 or momenta.max() > 1e-8:
    raise SystemExit("the satellite misses its goal, or its momentum changes")

figure, (left, right) = plt.subplots(1, 2, figsize=(9.0, 3.0), layout="constrained")
left.plot(times, off, label="hub off its goal")
left.plot(times, np.degrees(np.linalg.norm(found["dish"], axis=1)), label="dish off its rest")
left.set(xlabel="t (s)", ylabel="angle (deg)")
left.legend()
right.plot(times, sol.xs["qd"][:, 6:9], label=["x", "y", "z"])
right.set(xlabel="t (s)", ylabel="rate of the wheels (rad/s)")
right.legend()
figure.savefig("satellite.png", dpi=100)
