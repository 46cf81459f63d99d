"""Star tracker: a filter estimates the attitude of a satellite and its gyroscope's bias, within three deviations."""

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib import pyplot as plt

import twistax as tx
from twistax.estimation import ErrorStateKalman, Verdict

jax.config.update("jax_enable_x64", True)

RUNS, STEP, EVERY = 40, 0.5, 10  # a star tracker at every tenth reading of the gyroscope
DENSITY, DRIFT, STAR = 3e-5, 3e-7, np.array([2e-5, 2e-5, 1.5e-4])  # rad/sqrt(s), rad/s per sqrt(s), rad

R = tx.State("R", group=tx.SO3)  # attitude
bias = tx.State("bias", shape=(3,))  # rad/s
gyro = tx.Control("gyro", shape=(3,))  # rad/s
noise, drift = tx.Noise("noise", shape=(3,), density=DENSITY), tx.Noise("drift", shape=(3,), density=DRIFT)
satellite = tx.compile(tx.System(rates={R: gyro - bias - noise, bias: drift}))
kalman = ErrorStateKalman(satellite, [tx.Measurement("star", R, covariance=STAR**2)])

ts = STEP * np.arange(2400)  # s
rates = np.stack([0.01 * np.sin(0.01 * ts), 0.02 * np.cos(0.013 * ts), 0.001 + 0.0 * ts], axis=1)
start = np.concatenate([[1e-3] * 3, [2e-5] * 3])  # deviations at the start: rad, rad/s


def simulate(key):
    """A true motion, the readings of both sensors, and the run of the filter on them."""
    white, walk, first, seen = jax.random.split(key, 4)
    offset = start * jax.random.normal(first, (6,))
    biases = offset[3:] + DRIFT * np.sqrt(STEP) * jnp.cumsum(jax.random.normal(walk, rates.shape), axis=0)
    readings = rates + biases + DENSITY / np.sqrt(STEP) * jax.random.normal(white, rates.shape)

    def turn(attitude, rate):
        return attitude @ tx.lie.so3.exp(rate * STEP), attitude

    _, truth = jax.lax.scan(turn, tx.lie.so3.exp(offset[:3]), jnp.asarray(rates))
    errors = STAR * jax.random.normal(seen, (len(ts[::EVERY]), 3))
    stars = jax.vmap(lambda attitude, e: attitude @ tx.lie.so3.exp(e))(truth[::EVERY], errors)
    estimate = {"R": np.eye(3), "bias": np.zeros(3)}
    run = kalman.run({"star": (ts[::EVERY], stars)}, estimate, start**2, u={"gyro": tx.ZeroOrderHold(ts, readings)})
    count = run.ts.shape[0]
    return run, {"R": truth[:count], "bias": biases[:count]}


runs, truths = jax.jit(jax.vmap(simulate))(jax.random.split(jax.random.key(1), RUNS))
verdict = runs.consistency(truths)
errors = np.asarray(runs.errors(truths))
deviations = {name: np.asarray(value) for name, value in runs.deviations().items()}
late = np.degrees(np.abs(errors[:, -100:, :3])).mean() * 3600.0
print(f"attitude after {runs.ts[0, -1]:.0f} s: {late:.1f} arcsec mean error")
print(f"bias: {np.abs(errors[:, -1, 3:]).mean():.1e} rad/s, from {start[3]:.0e}")
print(verdict)
if verdict.verdict is not Verdict.CONSISTENT:
    raise SystemExit("the covariance is not consistent with the errors")

figure, axes = plt.subplots(1, 2, figsize=(9.0, 3.0), layout="constrained")
seen = slice(0, None, EVERY)  # the times of the star tracker
for axis, name, entry, factor in ((axes[0], "R", 2, np.degrees(3600.0)), (axes[1], "bias", 5, 1e6)):
    axis.plot(runs.ts[0, seen], factor * errors[:5, seen, entry].T, lw=0.7, label=["five satellites", *4 * [None]])
    bound = 3.0 * factor * deviations[name][0, seen, 2]
    axis.plot(runs.ts[0, seen], np.stack([bound, -bound], axis=1), "k--", lw=1.0, label=["3 deviations", None])
    axis.set(xlabel="t (s)")
axes[0].set(ylabel="error about the boresight (arcsec)", ylim=(-100.0, 100.0))
axes[1].set(ylabel="error of the bias (1e-6 rad/s)", ylim=(-30.0, 30.0))
axes[1].legend(fontsize="small")
figure.savefig("star_tracker.png", dpi=100)
