"""A neural network in the rates: the friction of a pendulum is learned from measured angles, through the simulation."""

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from matplotlib import pyplot as plt
from scipy.optimize import minimize

import twistax as tx

jax.config.update("jax_enable_x64", True)

q, w = tx.State("q"), tx.State("w")  # rad, rad/s
gravity = -9.81 / 0.8 * tx.Sin(q)  # of a pendulum of 0.8 m


def friction(w):
    """What is to be learned: viscous and dry, 1/s2."""
    return 0.15 * w + 0.8 * np.tanh(4.0 * w)


def network(p, w):
    """Of one number; odd, since friction is."""
    return p["out"] @ jnp.tanh(p["in"] * w)


draw = np.random.default_rng(0)
tree = {"in": draw.uniform(0.5, 4.0, 6), "out": 0.1 * draw.normal(size=6)}
weights = tx.ParameterTree("friction", tree)
learned = tx.Function(network, shape=(), name="learned")(weights, w)
model = tx.compile(tx.System(rates={q: w, w: gravity - learned}))
truth = tx.compile(tx.System(rates={q: w, w: gravity - friction(w)}))

start, times = {"q": 2.0, "w": 0.0}, np.linspace(0.0, 4.0, 81)
run = {"t1": 4.0, "dt": 0.02, "method": tx.RKMK(tx.tableaus.RK4), "save_at": times}
measured = tx.integrate(truth, start, **run).xs["q"] + 0.005 * draw.normal(size=81)
vector, unravel = ravel_pytree(tree)


@jax.jit
def misfit(vector):
    solution = tx.integrate(model, start, **run, params=weights.values(unravel(vector)))
    return jnp.mean((solution.xs["q"] - measured) ** 2)


before = float(misfit(vector))
fit = minimize(jax.jit(jax.value_and_grad(misfit)), vector, jac=True, method="L-BFGS-B", options={"maxiter": 150})
found = unravel(fit.x)
print(f"root mean square of the misfit: {np.sqrt(before):.4f} rad before, {np.sqrt(fit.fun):.4f} rad after")
if np.sqrt(fit.fun) > 0.007:
    raise SystemExit("the friction was not learned")

speeds = np.linspace(-6.0, 6.0, 121)
figure, axes = plt.subplots(1, 2, figsize=(7.0, 3.0), layout="constrained")
for panel, x, pairs, labels in (
    (axes[0], times, (measured, tx.integrate(model, start, **run, params=weights.values(found)).xs["q"]), ("s", "rad")),
    (axes[1], speeds, (friction(speeds), [network(found, s) for s in speeds]), ("rad/s", "1/s2")),
):
    panel.plot(x, pairs[0], ".", markersize=3, label="measured" if panel is axes[0] else "true friction")
    panel.plot(x, pairs[1], label="learned")
    panel.set(xlabel=labels[0], ylabel=labels[1])
    panel.legend(frameon=False)
figure.savefig("learned_friction.png", dpi=100)
