"""Flight by a filter: a quadrotor hovers in gusts, with a state estimated from a gyroscope and noisy positions."""

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib import pyplot as plt

import twistax as tx
from twistax.estimation import ErrorStateKalman

jax.config.update("jax_enable_x64", True)

STEP, COUNT, EVERY = 0.02, 500, 5  # s; positions at every fifth step
MASS, J = 0.8, np.diag([5e-3, 5e-3, 9e-3])  # kg, kg m2
GUSTS, GPS, GYRO, WALK = 0.3, 0.1, 0.02, 0.05  # N/sqrt(Hz), m, rad/s, N/sqrt(s)

g, V = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,))
wind = tx.State("wind", shape=(3,))  # N, in the world: no sensor measures it
lift, torque = tx.Control("lift"), tx.Control("torque", shape=(3,))
gusts, walk = tx.Noise("gusts", shape=(3,), density=GUSTS), tx.Noise("walk", shape=(3,), density=WALK)
outside = g[:3, :3].T @ (wind + gusts - np.array([0.0, 0.0, 9.81 * MASS]))
wrench = tx.lie.wrench(force=outside + tx.Concat(0.0, 0.0, lift), torque=torque)
M = np.block([[MASS * np.eye(3), np.zeros((3, 3))], [np.zeros((3, 3)), J]])
rates = {g: V, V: tx.linalg.Solve(M, wrench - tx.lie.AdjointDual(V, M @ V)), wind: walk}
quadrotor = tx.compile(tx.System(rates=rates))
position = tx.Measurement("position", g[:3, 3], covariance=GPS**2)
attitude = tx.Measurement("attitude", g[:3, :3], covariance=0.02**2)
gyro = tx.Measurement("gyro", V[3:], covariance=GYRO**2)
kalman = ErrorStateKalman(quadrotor, [position, attitude, gyro])


def control(x):
    """Lift and torque from an estimate: a pull towards the origin against the wind, and an attitude that gives it."""
    R, v = x["g"][:3, :3], x["g"][:3, :3] @ x["V"][:3]
    force = MASS * (jnp.array([0.0, 0.0, 9.81]) - 1.5 * x["g"][:3, 3] - 2.0 * v) - x["wind"]
    tilt = jnp.cross(jnp.array([0.0, 0.0, 1.0]), R.T @ force / jnp.linalg.norm(force))  # rad, in the body
    heading = jnp.array([0.0, 0.0, jnp.arctan2(R[1, 0], R[0, 0])])
    return {"lift": R[:, 2] @ force, "torque": J @ (60.0 * tilt - 10.0 * heading - 14.0 * x["V"][3:])}


def advance(carry, row):
    """A step of the flight and of the filter; the controller reads the estimate alone."""
    x, estimate, P = carry
    k, push, drift, seen = row
    u, t = control(estimate), k * STEP
    x = {name: a[-1] for name, a in tx.integrate(quadrotor, x, t1=STEP, steps=2, u=u).xs.items()}
    x = {**x, "V": x["V"].at[:3].add(x["g"][:3, :3].T @ push / MASS), "wind": x["wind"] + drift}
    estimate, P, _ = kalman.predict(t, estimate, P, STEP, u)
    fix = jnp.where(k % EVERY == 0, x["g"][:3, 3] + GPS * seen[:3], jnp.nan)  # NaN is a missing measurement
    turned = x["g"][:3, :3] @ tx.lie.so3.exp(0.02 * seen[3:6])
    for name, z in {"position": fix, "attitude": turned, "gyro": x["V"][3:] + GYRO * seen[6:]}.items():
        estimate, P, *_ = kalman.update(name, t + STEP, estimate, P, z)
    return (x, estimate, P), (x, estimate, P)


a, b, c = jax.random.split(jax.random.key(0), 3)
noise = jax.random.normal(a, (COUNT, 3)), jax.random.normal(b, (COUNT, 3)), jax.random.normal(c, (COUNT, 9))
rows = jnp.arange(COUNT), GUSTS * np.sqrt(STEP) * noise[0], WALK * np.sqrt(STEP) * noise[1], noise[2]
start = {"g": tx.pose(position=[0.0, 0.0, 0.0]), "V": np.zeros(6), "wind": np.array([1.0, -0.5, 0.0])}
guess = {"g": tx.pose(position=[0.3, -0.2, 0.2]), "V": np.zeros(6), "wind": np.zeros(3)}
first = jnp.diag(jnp.repeat(jnp.array([0.3, 0.05, 0.1, 0.1, 1.0]) ** 2, 3))
_, (xs, estimates, P) = jax.jit(lambda *carry: jax.lax.scan(advance, carry, rows))(start, guess, first)
errors = np.asarray(jax.vmap(quadrotor.group.difference)(estimates, xs))
deviations = np.sqrt(np.asarray(jnp.diagonal(P, axis1=1, axis2=2)))
inside = (np.abs(errors) < 3.0 * deviations).mean()
away = np.linalg.norm(xs["g"][:, :3, 3], axis=1)
print(f"within three deviations: {100.0 * inside:.1f} %; away from the origin: {away[100:].mean():.2f} m")
if inside < 0.97 or away[100:].max() > 1.5:
    raise SystemExit("the quadrotor does not hover")
figure, axes = plt.subplots(1, 2, figsize=(9.0, 3.0), layout="constrained")
for axis, entry, label in ((axes[0], 0, "error of the position (m)"), (axes[1], 12, "error of the wind (N)")):
    axis.plot(STEP * np.arange(COUNT), errors[:, entry], lw=0.8)
    bound = 3.0 * deviations[:, entry]
    axis.plot(STEP * np.arange(COUNT), np.stack([bound, -bound], axis=1), "k--", lw=1.0)
    axis.set(xlabel="t (s)", ylabel=label, ylim=(-3.0 * bound[-1], 3.0 * bound[-1]))
figure.savefig("estimated_flight.png", dpi=100)
