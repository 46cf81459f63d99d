"""Orbit of a satellite: the Earth's oblateness rotates the orbital plane at the rate of the first-order theory.

The term J2 of the gravity field makes the node regress by 3/2 J2 (R/p)^2 n cos(i) (Vallado, Fundamentals of
Astrodynamics and Applications, section 9.6). Sun-synchronous orbits use this effect.
"""

import jax
import numpy as np
from matplotlib import pyplot as plt

import twistax as tx

jax.config.update("jax_enable_x64", True)

MU, RADIUS, J2 = 3.986004418e14, 6.378137e6, 1.08262668e-3  # m3/s2, m, 1
r = tx.State("r", shape=(3,), scale=RADIUS, kind=tx.Point("inertial"))
v = tx.State("v", shape=(3,), scale=7e3, kind=tx.FreeVector("inertial"), unit="m/s")
d = tx.linalg.Norm(r)
up = r[2] / d
oblate = 1.5 * J2 * (RADIUS / d) ** 2 * tx.Concat(r[:2] * (5.0 * up**2 - 1.0), r[2] * (5.0 * up**2 - 3.0))
momentum = tx.linalg.Cross(r, v)
system = tx.System(
    rates={r: v, v: MU / d**3 * (oblate - r)},
    outputs={"momentum": momentum, "altitude": d - RADIUS},
)
dynamics = tx.compile(system)

a, inclination = RADIUS + 700e3, np.deg2rad(98.2)
speed, n = np.sqrt(MU / a), np.sqrt(MU / a**3)
start = {
    "r": np.array([a, 0.0, 0.0]),
    "v": speed * np.array([0.0, np.cos(inclination), np.sin(inclination)]),
}
day = 86_400.0
times = np.linspace(0.0, 10.0 * day, 2001)
solution = tx.integrate(dynamics, start, t1=times[-1], rtol=1e-10, save_at=times)
h = np.asarray(solution.outputs["momentum"])
node = np.rad2deg(np.unwrap(np.arctan2(h[:, 0], -h[:, 1])))
measured = np.polyfit(times / day, node, 1)[0]
expected = np.rad2deg(-1.5 * J2 * (RADIUS / a) ** 2 * n * np.cos(inclination)) * day
print(f"{int(solution.stats.steps)} steps for {n * times[-1] / (2.0 * np.pi):.0f} revolutions")
print(f"the node moves by {measured:.4f} degrees a day, by the theory {expected:.4f}; the Sun by 0.9856")

figure, axes = plt.subplots(figsize=(6.0, 3.0), layout="constrained")
axes.plot(times / day, node - expected * times / day)
axes.set(xlabel="time, days", ylabel="node less first-order theory, deg")
figure.savefig("orbit.png", dpi=100)
if abs(measured / expected - 1.0) > 0.01:
    raise SystemExit("the node does not move as the theory predicts")
