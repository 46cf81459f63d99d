"""Payload identification: mass, centre of mass and inertia of the load of a Panda, from noisy torques."""

from pathlib import Path

import jax
import numpy as np
from matplotlib import pyplot as plt

import twistax as tx
from twistax.mechanics import IdentificationStatus, SpatialInertia, identify, inverse_dynamics, load

jax.config.update("jax_enable_x64", True)
NOISE, SAMPLES = 0.2, 400  # N m; over ten seconds

arm = load(Path(__file__).with_name("panda.urdf"))
hand = arm.link("link7").body
payload = SpatialInertia(mass=1.2, center_of_mass=(0.03, -0.02, 0.18), inertia=np.diag([0.004, 0.005, 0.003]))
real = arm.with_inertia({"link7": hand + payload})

# A motion of sines about a middle posture, and the torques that are measured.
rng, t = np.random.default_rng(0), np.linspace(0.0, 10.0, SAMPLES)[:, None]
records = {"q": np.tile([0.0, -0.4, 0.0, -2.0, 0.0, 2.0, 0.8], (SAMPLES, 1)), "qd": 0.0, "qdd": 0.0}
for k in range(1, 6):
    w, a, b = 0.2 * np.pi * k, *rng.normal(scale=0.3 / k, size=(2, 7))
    records["q"] = records["q"] + a * np.sin(w * t) + b * np.cos(w * t)
    records["qd"] = records["qd"] + w * (a * np.cos(w * t) - b * np.sin(w * t))
    records["qdd"] = records["qdd"] - w**2 * (a * np.sin(w * t) + b * np.cos(w * t))
qdd = tx.State("qdd", (7,))
torques = tx.fast(tx.lower(inverse_dynamics(real, qdd=qdd)))
exact = jax.vmap(lambda x: torques(0.0, x))(records)
records["tau"] = np.asarray(exact) + NOISE * rng.normal(size=(SAMPLES, 7))

# All ten parameters of the last link, with what it holds; the other links are known.
result = identify(arm, records, links=["link7"], noise=NOISE, physical=True)
print(result)
held = result.mechanism.link("link7").body
mass = result.estimate("link7.mass")
weight, known = (float(tx.lower(body.mass)(0.0, {})) for body in (held, hand))
print(f"the payload has {weight - known:.3f} kg +- {mass[1]:.3f}, true 1.2 kg")
if result.status is not IdentificationStatus.IDENTIFIED or abs(weight - known - 1.2) > 4.0 * mass[1]:
    raise SystemExit("the error of the payload exceeds its deviation")

figure, (left, right) = plt.subplots(1, 2, figsize=(9.0, 3.2), layout="constrained")
left.plot(t, records["tau"][:, 3], ".", ms=2, label="measured")
left.plot(t, (records["tau"] - result.residuals)[:, 3], label="fitted")
left.set(xlabel="t (s)", ylabel="torque of joint 4 (N m)")
left.legend()
true = identify(arm, {**records, "tau": np.asarray(exact)}, links=["link7"], noise=NOISE).values
right.bar(range(10), (result.values - true) / result.standard_deviations)
right.set_xticks(range(10), [name.split(".")[1] for name in result.names], fontsize=7)
right.set(ylabel="error (standard deviations)", ylim=(-3.0, 3.0))
figure.savefig("identification.png", dpi=100)
