"""Arm from URDF: five lines load and simulate an arm, and compute the joint wrench in its prismatic joint."""

from pathlib import Path

import jax
import numpy as np
from matplotlib import pyplot as plt

import twistax as tx
from twistax.mechanics import gravity_forces, joint_wrench, load

jax.config.update("jax_enable_x64", True)

arm = load(Path(__file__).with_name("arm.urdf"))


def outputs(qdd: tx.Expr, tau: tx.Expr) -> dict[str, tx.Expr]:
    carried = joint_wrench(arm, "slide", qdd=qdd, frame="tool")  # [f; tau]
    return {"energy": arm.energy(), "tool": arm.pose("tool")[:3, 3], "carried": carried}


dynamics = tx.compile(arm.system(outputs=outputs))
start, off = {"q": np.array([0.3, -0.4, 0.1]), "qd": np.array([2.0, 0.0, 0.0])}, {"tau": np.zeros(3)}
sol = tx.integrate(dynamics, start, t1=0.5, dt=1e-3, u=off, save_at=np.linspace(0.0, 0.5, 101))

print("joints:", *arm.joints)
print("not used of the file:", *arm.notes)
found = jax.vmap(lambda t, x: dynamics.outputs(t, x, off))(sol.ts, sol.xs)
print("tool at the end (m):", np.round(found["tool"][-1], 4))
print("the slide carries at the end (N):", np.round(found["carried"][-1, :3], 2))
energy = np.asarray(found["energy"])
print(f"energy at the start and after 0.5 s: {energy[0]:.4f} J, {energy[-1]:.4f} J; friction took the difference")
if not np.all(np.diff(energy) < 1e-9):
    raise SystemExit("friction adds energy")

figure, (left, right) = plt.subplots(1, 2, figsize=(9.0, 3.0), layout="constrained")
left.plot(sol.ts, energy)
left.set(xlabel="t (s)", ylabel="energy (J)")
right.plot(sol.ts, found["carried"][:, :3], label=["x", "y", "z"])
right.set(xlabel="t (s)", ylabel="force carried by the slide, in the tool's axes (N)")
right.legend()
figure.savefig("urdf_arm.png", dpi=100)

# The same arm on a path of its joints, by gravity compensation and feedback: an animation of the shapes in the file.
t = tx.Time()
path = tx.Concat(1.2 * tx.Sin(t), 0.6 * tx.Sin(2.0 * t) - 0.3, 0.1 * tx.Sin(3.0 * t) + 0.15)
feedback = gravity_forces(arm) + 80.0 * (path - arm.q) - 8.0 * arm.qd
tracking = tx.compile(arm.system(controls=[], forces=feedback, outputs={"tool": arm.pose("tool")[:3, 3]}))
moved = tx.integrate(tracking, start, t1=2.0 * np.pi, rtol=1e-6, save_at=np.linspace(0.0, 2.0 * np.pi, 200))
moved.show("urdf_arm.html", bodies=arm, trails=["tool"], caption=["tool"])
