"""Guidance of a Mars landing: a Monte Carlo simulation in which the optimal descent is solved again at 10 Hz.

Initial state, engine thrust and wind are random. The guidance knows the thrust, but not the wind.
"""

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib import pyplot as plt

import twistax as tx

jax.config.update("jax_enable_x64", True)
PERIOD, STEPS, FLIGHTS, LAST = 0.1, 300, 8, 0.3  # s, at most, of the Monte Carlo, s before touchdown without guidance

p, v, m = tx.State("p", shape=(3,)), tx.State("v", shape=(3,)), tx.State("m")  # m, m/s, kg
thrust = tx.Control("thrust", shape=(3,))  # N
engine = tx.Parameter("engine", value=1.0)  # thrust over what is commanded
wind = tx.Parameter("wind", value=np.zeros(3))  # acceleration by it, m/s^2
size, gravity, gusts = tx.linalg.Norm(thrust), np.array([0.0, 0.0, -3.71]), np.array([0.03, 0.03, 0.0])  # m/s^2
lander = tx.compile(
    tx.System(
        rates={p: v, v: engine * thrust / m + wind + gravity, m: -5e-4 * engine * size},
        constraints={"most thrust": size <= 16e3, "least thrust": size >= 3e3},
    )
)
start = {"p": np.array([450.0, -330.0, 1500.0]), "v": np.array([-20.0, 10.0, -75.0]), "m": np.array(1900.0)}
mesh = {"nodes": 13, "substeps": 1, "final_time": (0.1, 60.0), "final_time_guess": 25.0}
problem = tx.trajectory.Problem(lander, tx.Maximize(m), **mesh, initial=start, final={p: np.zeros(3), v: np.zeros(3)})
result = problem.solve()
print(result.message)
guidance = tx.trajectory.solution(problem)


def dispersed(key):
    a, b, c, d = jax.random.split(key, 4)
    x = {"p": start["p"] + 40.0 * jax.random.normal(a, (3,)), "v": start["v"] + 3.0 * jax.random.normal(b, (3,))}
    params = {"engine": 1.0 + 0.02 * jax.random.normal(c), "wind": gusts * jax.random.normal(d, (3,))}
    return {"x": {**x, "m": jnp.asarray(start["m"])}, "params": params}


def flight(member):
    def period(state, _):
        x, u, left, solved = state
        plan = guidance(initial=x, params={"engine": member["params"]["engine"]})
        good = (plan.solved > 0.0) & (left > LAST)  # else the last command holds
        u, left = jnp.where(good, plan.us["thrust"][0], u), jnp.where(good, plan.final_time, left)
        after = tx.integrate(lander, x, t1=PERIOD, dt=PERIOD / 2, u={"thrust": u}, params=member["params"]).xs
        flying = left > LAST
        x = {name: jnp.where(flying, after[name][-1], x[name]) for name in x}
        return (x, u, jnp.where(flying, left - PERIOD, left), solved + jnp.array([good, flying])), x["p"]

    first = (member["x"], jnp.asarray(result.us["thrust"][0]), jnp.asarray(result.final_time), jnp.zeros(2))
    (x, _, left, solved), path = jax.lax.scan(period, first, None, length=STEPS)
    results = {"miss": 100.0 * (x["p"] + 0.5 * left * x["v"])[:2], "used": member["x"]["m"] - x["m"]}  # cm, kg
    return {**results, "solved": solved[0] / solved[1], "path": path}


values = tx.sweep(flight, dispersed, count=FLIGHTS, progress=False).values
miss, used = np.asarray(values["miss"]), np.asarray(values["used"])
off, lowest = np.linalg.norm(miss, axis=1).max(), np.asarray(values["path"])[..., 2].min()
print(f"{FLIGHTS} flights: {off:.1f} cm off the pad at most, {used.mean():.1f} +- {used.std():.1f} kg of propellant")
print(f"{100.0 * np.mean(values['solved']):.1f} % of the plans solved, lowest height {lowest:.2f} m")

figure, (above, side, bars) = plt.subplots(1, 3, figsize=(9.0, 3.0), layout="constrained")
angles = np.linspace(0.0, 2.0 * np.pi, 100)
ellipse = (
    2.0 * np.linalg.cholesky(np.cov(miss.T)) @ np.array([np.cos(angles), np.sin(angles)]) + miss.mean(axis=0)[:, None]
)
above.plot(*miss.T, "k.", label="touchdown")
above.plot(*ellipse, label="two standard deviations")
above.set(xlabel="x, cm", ylabel="y, cm")
above.legend(fontsize="small")
for path in np.asarray(values["path"]):
    side.plot(path[:, 0], path[:, 2], lw=0.8)
side.set(xlabel="x, m", ylabel="height, m")
bars.hist(used, bins=6)
bars.set(xlabel="propellant, kg", ylabel="flights")
figure.savefig("landing_guidance.png", dpi=100)
