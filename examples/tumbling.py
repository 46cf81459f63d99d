"""Unstable axis: a box that spins about its intermediate axis turns over periodically, as Euler's equations predict.

Its energy and the size of its angular momentum are constant. The time between two turns agrees with the exact one,
a complete elliptic integral of the first kind.
"""

import jax
import numpy as np
from matplotlib import pyplot as plt
from scipy.special import ellipk

import twistax as tx

jax.config.update("jax_enable_x64", True)

J = np.array([1.0, 2.0, 3.0])  # principal moments of inertia, kg m2
R = tx.State("R", group=tx.SO3, kind=tx.kinds.Rotation("world", "body"))
w = tx.State("w", shape=(3,), kind=tx.FreeVector("body"), unit="rad/s")
L = J * w
system = tx.System(
    rates={R: w, w: tx.linalg.Cross(L, w) / J},
    outputs={"energy": 0.5 * w @ L, "momentum": R @ L},
)
dynamics = tx.compile(system)

start = {"R": np.eye(3), "w": np.array([1e-3, 2.0, 2e-3])}
times = np.linspace(0.0, 40.0, 801)
solution = tx.integrate(dynamics, start, t1=40.0, rtol=1e-10, save_at=times)
w, momentum = np.asarray(solution.xs["w"]), solution.outputs["momentum"]
print(f"largest change of the angular momentum: {np.abs(momentum - momentum[0]).max():.1e} N m s")

# The period of the body rate where L^2 > 2 E J2 (Landau and Lifshitz, Mechanics, section 37).
E, L2 = 0.5 * start["w"] @ (J * start["w"]), ((J * start["w"]) ** 2).sum()
one, three = 2.0 * E * J[2] - L2, L2 - 2.0 * E * J[0]
m = (J[1] - J[0]) * one / ((J[2] - J[1]) * three)
half = 2.0 * ellipk(m) * np.sqrt(J.prod() / ((J[2] - J[1]) * three))
crossings = times[:-1][np.diff(np.sign(w[:, 1])) != 0]
print(f"half a period: {np.diff(crossings).mean():.2f} s, by the elliptic integral {half:.2f} s")

figure, axes = plt.subplots(figsize=(6.0, 3.2), layout="constrained")
axes.plot(times, w, label=["long axis", "middle axis", "short axis"])
axes.set(xlabel="time, s", ylabel="body rate, rad/s")
axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
figure.savefig("tumbling.png", dpi=100)
if abs(np.diff(crossings).mean() - half) > 0.1:
    raise SystemExit("the period is not that of the elliptic integral")
