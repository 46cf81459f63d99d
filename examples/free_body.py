"""Free rigid body: the centre of mass is not at the origin, and the momentum in the world frame is conserved."""

import jax
import numpy as np
from matplotlib import pyplot as plt

import twistax as tx

jax.config.update("jax_enable_x64", True)

mass, offset, inertia = 2.0, np.array([0.1, -0.05, 0.2]), np.diag([1.0, 2.0, 3.0])  # kg, m, kg m2 about the centre
c = np.array(tx.lie.so3.hat(offset))
M0 = np.block([[mass * np.eye(3), -mass * c], [mass * c, inertia - mass * c @ c]])

g = tx.State("g", group=tx.SE3, kind=tx.kinds.Pose("world", "body"))  # pose of the body in the world
V = tx.State("V", shape=(6,), kind=tx.Twist("body"))  # body twist [v; w], m/s and rad/s
M = tx.Parameter("M", shape=(6, 6), value=M0, kind=tx.kinds.Inertia("body"))
momentum = M @ V

body = tx.System(
    rates={g: V, V: tx.linalg.Solve(M, -tx.lie.AdjointDual(V, momentum))},
    outputs={"momentum": tx.lie.SE3AdjointDual(g) @ momentum, "energy": 0.5 * V @ momentum},
)
dynamics = tx.compile(body)
print(dynamics.explain())

start = {"g": tx.pose(), "V": np.array([1.0, 0.5, -0.3, 0.4, 2.0, -0.7])}
solution = tx.integrate(dynamics, start, t1=5.0, dt=1e-3, save_at=np.linspace(0.0, 5.0, 101))
outputs = solution.outputs

print("\n  t     position (m)              momentum in the world frame (N s, N m s)            energy (J)")
rows = zip(*map(np.asarray, (solution.ts, solution.xs["g"], outputs["momentum"], outputs["energy"])))
for t, pose, mu, energy in list(rows)[::20]:
    print(f"{t:4.1f}   {np.round(pose[:3, 3], 4)}   {np.round(mu, 6)}   {energy:.9f}")

drift = np.abs(outputs["momentum"] - outputs["momentum"][0]).max()
print(f"\nlargest change of the world momentum in 5 s: {drift:.1e}")
if drift > 1e-9:
    raise SystemExit("momentum is not conserved")

figure, (left, right) = plt.subplots(1, 2, figsize=(8.0, 3.0), layout="constrained")
left.plot(solution.ts, solution.xs["g"][:, :3, 3], label=["x", "y", "z"])
left.set(xlabel="time, s", ylabel="position of the origin, m")
left.legend(frameon=False)
right.plot(solution.ts, solution.xs["V"][:, 3:], label=["x", "y", "z"])
right.set(xlabel="time, s", ylabel="body rate, rad/s")
figure.savefig("free_body.png", dpi=100)
