"""Free-flying arm: the motors of an arm rotate the satellite that carries it, and the total momentum stays zero."""

import jax
import numpy as np
from matplotlib import pyplot as plt

import twistax as tx
from twistax.mechanics import Link, Mechanism, SpatialInertia, joints, spatial_momentum

jax.config.update("jax_enable_x64", True)

hull = SpatialInertia(mass=120.0, inertia=np.diag([20.0, 18.0, 15.0]))
rod = SpatialInertia(mass=6.0, center_of_mass=(0.4, 0.0, 0.0), inertia=np.diag([0.02, 0.35, 0.35]))
robot = Mechanism(
    [
        Link(joints.Free("hull"), hull, tx.pose()),
        Link(joints.Spherical("shoulder"), rod, tx.pose(position=[0.5, 0.0, 0.3]), parent="hull"),
        Link(joints.Revolute("elbow", axis=(0.0, 1.0, 0.0)), rod, tx.pose(position=[0.8, 0.0, 0.0]), parent="shoulder"),
    ],
    gravity=np.zeros(3),
)
dynamics = tx.compile(robot.system(outputs={"momentum": spatial_momentum(robot), "energy": robot.energy()}))
start = {
    "q": np.array([0.4]),
    "hull_position": np.eye(4),
    "shoulder_position": np.eye(3),
    "qd": np.zeros(robot.dofs),
}
motors = {"tau": np.array([0.3, -0.5, 0.2, 0.4])}  # N m, three of the shoulder and the elbow's
sol = tx.integrate(dynamics, start, t1=5.0, dt=1e-3, u=motors, save_at=np.linspace(0.0, 5.0, 101))
momentum = np.asarray(jax.vmap(lambda t, x: dynamics.outputs(t, x, motors)["momentum"])(sol.ts, sol.xs))

trace = np.trace(sol.xs["hull_position"][:, :3, :3], axis1=1, axis2=2)
turn = np.degrees(np.arccos(np.clip(0.5 * (trace - 1.0), -1.0, 1.0)))
print(f"the satellite has turned by {turn[-1]:.2f} degrees")
print(f"largest momentum: {np.max(np.abs(momentum)):.1e} N s and N m s")
if not np.max(np.abs(momentum)) < 1e-10:
    raise SystemExit("the motors change the total momentum")

figure, axes = plt.subplots(figsize=(5.0, 3.0), layout="constrained")
axes.plot(sol.ts, turn)
axes.set(xlabel="t (s)", ylabel="turn of the satellite (degrees)")
figure.savefig("space_arm.png", dpi=100)
