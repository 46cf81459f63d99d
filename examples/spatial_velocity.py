"""Body and spatial velocity: the same six numbers as a twist in the body frame and in the world frame.

A state's rate is its body velocity. A spatial (world) velocity xi_s is written with the adjoint of the inverse pose.
"""

import jax
import numpy as np
from matplotlib import pyplot as plt

import twistax as tx

jax.config.update("jax_enable_x64", True)

g = tx.State("g", group=tx.SE3, kind=tx.kinds.Pose("world", "body"))
in_body_axes = tx.Control("xi", shape=(6,), kind=tx.Twist("body"))
in_world_axes = tx.Control("xi", shape=(6,), kind=tx.Twist("world"))

in_body = tx.compile(tx.System(rates={g: in_body_axes}))
in_world = tx.compile(tx.System(rates={g: tx.lie.SE3Adjoint(tx.lie.Inverse(g)) @ in_world_axes}))

start = {"g": tx.pose(position=[1.0, 0.0, 0.0], euler=[0.0, 0.0, np.pi / 2])}
u = {"xi": np.array([0.5, 0.0, 0.1, 0.0, 0.0, np.pi / 4])}  # m/s and rad/s
body_end = tx.integrate(in_body, start, t1=2.0, dt=0.1, u=u).xs["g"][-1]
world_end = tx.integrate(in_world, start, t1=2.0, dt=0.1, u=u).xs["g"][-1]

# For a constant velocity both have exact solutions: g0 Exp(t xi) and Exp(t xi) g0.
step = tx.lie.se3.exp(2.0 * u["xi"])
exact = {"body": start["g"] @ step, "world": step @ start["g"]}
for name, end in (("body", body_end), ("world", world_end)):
    error = np.abs(end - exact[name]).max()
    print(
        f"velocity in the {name} frame: ends at {np.round(end[:3, 3], 6)}, error against the exact solution {error:.1e}"
    )
    if error > 1e-4:
        raise SystemExit("the integration has a large error")

times = np.linspace(0.0, 2.0, 41)
figure, axes = plt.subplots(figsize=(6.0, 3.6), layout="constrained")
for name, dynamics in (("body", in_body), ("world", in_world)):
    path = tx.integrate(dynamics, start, t1=2.0, dt=0.05, u=u, save_at=times).xs["g"][:, :2, 3]
    axes.plot(path[:, 0], path[:, 1], ".-", markersize=3, label=f"twist in the {name} frame")
axes.set(xlabel="x, m", ylabel="y, m", aspect="equal")
axes.legend(frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0))
figure.savefig("spatial_velocity.png", dpi=100)
