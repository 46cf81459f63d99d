"""GPS and INS: a filter with 15 states flies through an outage of GPS, and its covariance grows as its errors do."""

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib import pyplot as plt

import twistax as tx
from twistax.estimation import ErrorStateKalman, Verdict

jax.config.update("jax_enable_x64", True)

RUNS, STEP, END, OUTAGE = 40, 0.1, 90.0, (40.0, 70.0)
GYRO, ACCELEROMETER, GYRO_WALK, ACCELEROMETER_WALK = 2e-4, 2e-3, 1e-5, 1e-4  # densities, SI units per sqrt(Hz)
GPS = 1.5  # m
DOWN = np.array([0.0, 0.0, 9.81])  # m/s2, axes north, east, down

R = tx.State("R", group=tx.SO3)
v, p, bg, ba = (tx.State(name, shape=(3,)) for name in ("v", "p", "bg", "ba"))
gyro, accelerometer = tx.Control("gyro", shape=(3,)), tx.Control("accelerometer", shape=(3,))
ng, na, wg, wa = (
    tx.Noise(name, shape=(3,), density=density)
    for name, density in (("ng", GYRO), ("na", ACCELEROMETER), ("wg", GYRO_WALK), ("wa", ACCELEROMETER_WALK))
)
force = R @ (accelerometer - ba - na)
ins = tx.compile(tx.System(rates={R: gyro - bg - ng, v: force + DOWN, p: v, bg: wg, ba: wa}))
kalman = ErrorStateKalman(ins, [tx.Measurement("gps", p, covariance=GPS**2)])

# A turning flight. Its readings are held between samples; another integrator than the filter's makes the truth.
ts = np.arange(0.0, END, STEP)
turn, climb = 0.15 * np.sin(0.2 * ts), 0.05 * np.cos(0.15 * ts)
rates = np.stack([0.1 * np.cos(0.3 * ts), climb, turn], axis=1)
forces = np.stack([0.5 * np.sin(0.1 * ts), 30.0 * turn, -9.81 + 30.0 * climb], axis=1)
held = {"gyro": tx.ZeroOrderHold(ts, rates), "accelerometer": tx.ZeroOrderHold(ts, forces)}
zero = np.zeros(3)
start = {"R": np.eye(3), "v": np.array([30.0, 0.0, 0.0]), "p": zero, "bg": zero, "ba": zero}
flight = tx.integrate(ins, start, t1=ts[-1], rtol=1e-10, atol=1e-10, u=held, save_at=ts)
seconds = ts[:: round(1.0 / STEP)]
seen = (seconds < OUTAGE[0]) | (seconds > OUTAGE[1])
first = np.repeat([0.02, 0.3, 1.5, 1e-3, 2e-2], 3)  # deviations at the start: rad, m/s, m, rad/s, m/s2


def simulate(key):
    """The run of a filter with random biases, noise and start."""
    white, walk, begin, errors = jax.random.split(key, 4)
    offset = first * jax.random.normal(begin, (15,))
    scale = np.repeat([GYRO_WALK, ACCELEROMETER_WALK], 3) * np.sqrt(STEP)
    steps = scale * jax.random.normal(walk, (len(ts), 6)).at[0].set(0.0)
    biases = offset[9:] + jnp.cumsum(steps, axis=0)
    scale = np.repeat([GYRO, ACCELEROMETER], 3) / np.sqrt(STEP)
    readings = np.concatenate([rates, forces], axis=1) + biases + scale * jax.random.normal(white, biases.shape)
    truth = {**flight.xs, "bg": biases[:, :3], "ba": biases[:, 3:]}
    estimate = {name: x[0] for name, x in truth.items()}
    estimate = ins.group.retract({**estimate, "bg": zero, "ba": zero}, jnp.zeros(15).at[:9].set(-offset[:9]))
    positions = truth["p"][:: round(1.0 / STEP)] + GPS * jax.random.normal(errors, (len(seconds), 3))
    u = {"gyro": tx.ZeroOrderHold(ts, readings[:, :3]), "accelerometer": tx.ZeroOrderHold(ts, readings[:, 3:])}
    run = kalman.run({"gps": (seconds[seen], positions[seen])}, estimate, first**2, u=u, save_at=ts[-1:])
    return run, truth


runs, truths = jax.jit(jax.vmap(simulate))(jax.random.split(jax.random.key(0), RUNS))
verdict = runs.consistency(truths)
errors, deviations = np.linalg.norm(runs.errors(truths)[..., 6:9], axis=-1), np.asarray(runs.deviations()["p"])
before, after = (round(t / STEP) for t in OUTAGE)
print(f"position: {errors[:, before].mean():.2f} m before the outage, {errors[:, after].mean():.1f} m at its end")
print(f"by the covariance: {np.linalg.norm(deviations[:, after], axis=-1).mean():.1f} m at its end")
print(verdict)
if verdict.verdict is not Verdict.CONSISTENT:
    raise SystemExit("the covariance is honest")

figure, axes = plt.subplots(figsize=(9.0, 3.0), layout="constrained")
axes.plot(ts, errors[:8].T, lw=0.7)
axes.plot(ts, 3.0 * np.linalg.norm(deviations[0], axis=-1), "k--", label="3 deviations")
axes.axvspan(*OUTAGE, color="0.9", label="no GPS")
axes.set(xlabel="t (s)", ylabel="error of the position (m)", yscale="log", ylim=(0.05, 500.0))
axes.legend(loc="upper left")
figure.savefig("gps_ins.png", dpi=100)
