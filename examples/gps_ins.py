"""GPS and INS: in a GPS outage an invariant filter is consistent, and a filter with Euler angles is optimistic."""

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib import pyplot as plt

import twistax as tx
from twistax.estimation import ErrorStateKalman, InvariantKalman, Verdict

jax.config.update("jax_enable_x64", True)

RUNS, STEP, END, OUTAGE = 40, 0.1, 90.0, (40.0, 70.0)
DENSITIES = np.repeat([2e-4, 2e-3, 1e-5, 1e-4], 3)  # gyroscope, accelerometer, their drifts; SI units per sqrt(Hz)
GPS, DOWN = 1.5, np.array([0.0, 0.0, 9.81])  # m; m/s2, axes north, east, down

X = tx.State("X", group=tx.ExtendedPose())  # [R, v, p; 0, I]
angles, v, p, bg, ba = (tx.State(name, shape=(3,)) for name in ("angles", "v", "p", "bg", "ba"))
gyro, accelerometer = tx.Control("gyro", shape=(3,)), tx.Control("accelerometer", shape=(3,))
noise = tx.Noise("noise", shape=(12,), density=DENSITIES)
w, force, drifts = gyro - bg - noise[:3], accelerometer - ba - noise[3:6], {bg: noise[6:9], ba: noise[9:]}
body = tx.Concat(w, force + X[:3, :3].T @ DOWN, X[:3, :3].T @ X[:3, 3])
ins = tx.compile(tx.System(rates={X: body, **drifts}))
s, c, turn = np.sin(angles), np.cos(angles), np.sin(angles[0]) * w[1] + np.cos(angles[0]) * w[2]
roll_pitch_yaw = tx.Stack(w[0] + s[1] / c[1] * turn, c[0] * w[1] - s[0] * w[2], turn / c[1])
acceleration = tx.lie.EulerRotation(angles) @ force + DOWN
by_angles = tx.compile(tx.System(rates={angles: roll_pitch_yaw, v: acceleration, p: v, **drifts}))
invariant = InvariantKalman(ins, [tx.Measurement("gps", X[:3, 4], covariance=GPS**2)])
plain = ErrorStateKalman(by_angles, [tx.Measurement("gps", p, covariance=GPS**2)])

# A turning flight. Its readings are held between samples; another integrator than the filter's makes the truth.
ts = np.arange(0.0, END, STEP)
turns, climb = 0.15 * np.sin(0.2 * ts), 0.05 * np.cos(0.15 * ts)
forces = [0.5 * np.sin(0.1 * ts), 30.0 * turns, 30.0 * climb - 9.81]
readings = np.stack([0.1 * np.cos(0.3 * ts), climb, turns, *forces], axis=1)
start = {"X": tx.ExtendedPose().element(np.eye(3), [30.0, 0.0, 0.0], np.zeros(3)), "bg": np.zeros(3), "ba": np.zeros(3)}
u = {"gyro": tx.ZeroOrderHold(ts, readings[:, :3]), "accelerometer": tx.ZeroOrderHold(ts, readings[:, 3:])}
flight = tx.integrate(ins, start, t1=ts[-1], rtol=1e-10, atol=1e-10, u=u, save_at=ts).xs["X"]
parts = {"angles": jax.vmap(tx.lie.euler)(flight[:, :3, :3]), "v": flight[:, :3, 3], "p": flight[:, :3, 4]}
seconds = ts[:: round(1.0 / STEP)]
seen = (seconds < OUTAGE[0]) | (seconds > OUTAGE[1])
first = np.repeat([0.02, 0.3, 1.5, 1e-3, 2e-2], 3)  # deviations at the start: rad, m/s, m, rad/s, m/s2


def simulate(key, kalman, group, states):
    """The run of a filter with random biases, noise and start."""
    white, walk, begin, errors = jax.random.split(key, 4)
    offset = first * jax.random.normal(begin, (15,))
    steps = DENSITIES[6:] * np.sqrt(STEP) * jax.random.normal(walk, (len(ts), 6)).at[0].set(0.0)
    biases = offset[9:] + jnp.cumsum(steps, axis=0)
    measured = readings + biases + DENSITIES[:6] / np.sqrt(STEP) * jax.random.normal(white, biases.shape)
    truth = {**states, "bg": biases[:, :3], "ba": biases[:, 3:]}
    estimate = group.retract({name: x[0] for name, x in truth.items()}, -offset)  # with biases of zero
    positions = flight[:: round(1.0 / STEP), :3, 4] + GPS * jax.random.normal(errors, (len(seconds), 3))
    u = {"gyro": tx.ZeroOrderHold(ts, measured[:, :3]), "accelerometer": tx.ZeroOrderHold(ts, measured[:, 3:])}
    return kalman.run({"gps": (seconds[seen], positions[seen])}, estimate, first**2, u=u, save_at=ts[-1:]), truth


keys, results = jax.random.split(jax.random.key(0), RUNS), {}
for kalman, dynamics, states in ((invariant, ins, {"X": flight}), (plain, by_angles, parts)):
    flights = jax.jit(jax.vmap(lambda key, k=kalman, g=dynamics.group, s=states: simulate(key, k, g, s)))
    results[kalman] = runs, truths = flights(keys)
    print(f"{type(kalman).__name__}: {runs.consistency(truths)}")
runs, truths = results[invariant]
if runs.consistency(truths).verdict is not Verdict.CONSISTENT:
    raise SystemExit("the covariance is not consistent with the errors")
errors = np.linalg.norm(runs.errors(truths)[..., 6:9], axis=-1)
deviations = np.linalg.norm(runs.deviations()["X"][..., 6:9], axis=-1)
last = round(OUTAGE[1] / STEP)
print(
    f"position after the outage: {errors[:, last].mean():.1f} m, by the covariance {deviations[:, last].mean():.1f} m"
)
figure, axes = plt.subplots(figsize=(9.0, 3.0), layout="constrained")
axes.plot(ts, errors[:8].T, lw=0.7)
axes.plot(ts, 3.0 * deviations[0], "k--", label="3 deviations")
axes.axvspan(*OUTAGE, color="0.9", label="no GPS")
axes.set(xlabel="t (s)", ylabel="error of the position (m)", yscale="log", ylim=(0.05, 500.0))
axes.legend(loc="upper left")
figure.savefig("gps_ins.png", dpi=100)
