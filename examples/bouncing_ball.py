"""Bouncing ball: each bounce is the end of a phase, at the time of an event, which is accurate to round-off.

The derivative of the last height with respect to the restitution includes the effect of all bounces.
"""

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib import pyplot as plt

import twistax as tx

jax.config.update("jax_enable_x64", True)

h, v = tx.State("h", unit="m"), tx.State("v", unit="m/s")  # height and speed
e = tx.Parameter("e", value=0.8, unit="1")  # restitution
ball = tx.compile(tx.System(rates={h: v, v: -9.81}))
flight = tx.Phase(ball, event=tx.Event(h, direction=-1), duration=5.0)
bounce = {v: -e * v, h: 0.0}  # the first state of the next phase, by the last one
COUNT, END = 4, 3.0


def bounces(restitution, save_at):
    return tx.integrate_phases(
        [flight] * COUNT, {"h": 2.0, "v": 0.0}, [bounce] * (COUNT - 1), rtol=1e-10, params={"e": restitution},
        save_at=save_at,
    )  # fmt: skip


times = np.linspace(0.0, END, 301)
solution = bounces(0.8, times)
first = np.sqrt(2.0 * 2.0 / 9.81)
exact = first + 2.0 * first * np.cumsum(0.8 ** np.arange(1, COUNT))
found = np.array([float(phase.ts[-1]) for phase in solution.phases])
print("bounces at (s):", np.round(found, 4))
print(f"largest error of their times: {np.abs(found - np.concatenate([[first], exact])).max():.1e} s")
last = lambda restitution: bounces(restitution, None).phases[-1].ts[-1]  # noqa: E731
slope = jax.grad(last)(jnp.asarray(0.8))
exact_slope = 2.0 * first * sum(k * 0.8 ** (k - 1) for k in range(1, COUNT))
print(f"d(time of the last bounce)/d(restitution) = {slope:.6f} s, exact {exact_slope:.6f} s")

figure, axes = plt.subplots(figsize=(6.0, 3.0), layout="constrained")
axes.plot(solution.ts, solution.xs["h"])
axes.plot(found, 0.0 * found, ".")
axes.set(xlabel="time, s", ylabel="height, m")
figure.savefig("bouncing_ball.png", dpi=100)
if abs(slope - exact_slope) > 1e-6:
    raise SystemExit("the derivative is wrong across the bounces")
