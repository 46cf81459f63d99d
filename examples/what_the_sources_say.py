"""Two published formulas compared with those of twistax: the physical effect of a wrong block and of a wrong sign.

1. OpenSCvx 0.5.2 documents twists as [v; w], but its coadjoint reads the momentum in the other order. A ball that
   spins, without a force, must move on a straight line. With the published formula it moves in a circle.
2. A Runge-Kutta-Munthe-Kaas step with g' = g Omega^ and g = g_n Exp(eta) needs dexp^-1 at -eta. With +eta, as printed
   in the first edition of Aetherion's unified notation, the classical fourth-order method has order 2.

`--plot FILE` sets the file of the figure. docs/conventions.md lists all errors in the sources.
"""

import argparse

import jax
import jax.numpy as jnp
import numpy as np

import twistax as tx

jax.config.update("jax_enable_x64", True)

arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
arguments.add_argument("--plot", metavar="FILE", default="what_the_sources_say.png", help="where the figure goes")
figure_file = arguments.parse_args().plot

g, V = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,))

# ---- a ball that nothing pushes ------------------------------------------------------------------------------------

mass, J = 2.0, 0.5  # kg, kg m2
M = np.diag([mass] * 3 + [J] * 3)
v, w = tx.lie.linear(V), tx.lie.angular(V)
p, L = tx.lie.linear(M @ V), tx.lie.angular(M @ V)
coadjoints = {
    "twistax": tx.lie.AdjointDual(V, M @ V),
    "as published": tx.lie.wrench(force=tx.linalg.Cross(w, p) + tx.linalg.Cross(v, L), torque=tx.linalg.Cross(w, L)),
}
start = {"g": np.eye(4), "V": np.array([1.0, 0.0, 0.0, 0.0, 0.0, 4.0])}  # 1 m/s ahead, 4 rad/s of spin
times = np.linspace(0.0, 6.0, 241)
paths, energies, momenta = {}, {}, {}
for name, coadjoint in coadjoints.items():
    ball = tx.compile(
        tx.System(
            rates={g: V, V: tx.linalg.Solve(M, -coadjoint)},
            outputs={"energy": 0.5 * V @ (M @ V), "momentum": tx.lie.SE3AdjointDual(g) @ (M @ V)},
        )
    )
    flight = tx.integrate(ball, start, t1=times[-1], dt=1e-3, save_at=times)
    outputs = jax.vmap(lambda t, x, ball=ball: ball.outputs(t, x))(flight.ts, flight.xs)
    paths[name] = np.asarray(flight.xs["g"][:, :2, 3])
    energies[name] = float(np.ptp(outputs["energy"]))
    momenta[name] = float(np.abs(outputs["momentum"] - outputs["momentum"][0])[:, :3].max())

print("a force-free spinning ball, 6 s")
for name, path in paths.items():
    off_line, drift = np.abs(path[:, 1]).max(), momenta[name]
    print(
        f"  {name:14}ends {np.hypot(*path[-1]):.6f} m from the start, leaves the line by {off_line:.1e} m,"
        f" world momentum changes by {drift:.1e} N s, energy by {energies[name]:.1e} J"
    )

# ---- the sign in a Munthe-Kaas step --------------------------------------------------------------------------------

M = np.diag([2.0, 2.0, 2.0, 1.0, 2.0, 3.0])
body = tx.compile(tx.System(rates={g: V, V: tx.linalg.Solve(M, -tx.lie.AdjointDual(V, M @ V))}))
start = {"g": np.eye(4), "V": np.array([0.4, -0.2, 0.3, 0.9, 1.4, -0.7])}
rk4 = tx.tableaus.RK4


@jax.jit
def munthe_kaas(sign: float, count: int) -> jax.Array:
    """The pose after 1 s in `count` steps; eta' = J_r(sign eta)^-1 Omega, and the right sign is +1."""

    def slope(x, eta, gain):
        here = {"g": x["g"] @ tx.lie.se3.exp(eta), "V": x["V"] + gain}
        rate = body(0.0, here)
        return tx.lie.se3.right_jacobian_inv(sign * eta) @ rate["g"], rate["V"]

    def step(_, x):
        slopes = []
        for row in (*rk4.a, rk4.b):
            eta, gain = (sum((a / count * k[i] for a, k in zip(row, slopes) if a), jnp.zeros(6)) for i in (0, 1))
            slopes.append(slope(x, eta, gain))
        return {"g": x["g"] @ tx.lie.se3.exp(eta), "V": x["V"] + gain}

    return jax.lax.fori_loop(0, count, step, jax.tree.map(jnp.asarray, start))["g"]


exact = np.asarray(tx.integrate(body, start, t1=1.0, dt=1e-3).xs["g"][-1])
counts = np.array([10, 20, 40, 80])
errors = {
    name: np.array([np.abs(munthe_kaas(sign, n) - exact).max() for n in counts])
    for name, sign in (("twistax", 1.0), ("as published", -1.0))
}
orders = {name: -np.polyfit(np.log(counts), np.log(error), 1)[0] for name, error in errors.items()}
print("\nclassical Runge-Kutta on SE(3), a force-free asymmetric body, 1 s")
for name, error in errors.items():
    print(f"  {name:14}errors {' '.join(f'{e:.1e}' for e in error)}: observed order {orders[name]:.2f}")

if not (momenta["twistax"] < 1e-9 < 1.0 < momenta["as published"]):
    raise SystemExit("the motion of the ball differs from this page")
if not (abs(orders["twistax"] - 4.0) < 0.15 and abs(orders["as published"] - 2.0) < 0.15):
    raise SystemExit("the orders differ from this page")

# ---- the figure ----------------------------------------------------------------------------------------------------

try:
    import matplotlib.pyplot as plt
except ImportError:
    raise SystemExit("\nno figure: it needs matplotlib (pip install 'twistax[plot]')") from None

colours = {"twistax": "tab:blue", "as published": "tab:red"}
figure, (left, right) = plt.subplots(1, 2, figsize=(9.0, 3.6), layout="constrained")
for name, path in paths.items():
    left.plot(path[:, 0], path[:, 1], color=colours[name], label=name)
left.set(xlabel="x (m)", ylabel="y (m)", title="A spinning ball that nothing pushes", aspect="equal")
for name, error in errors.items():
    right.loglog(counts, error, "o-", color=colours[name], label=f"{name}: order {orders[name]:.2f}")
right.set(xlabel="steps", ylabel="error of the pose after 1 s", title="Classical Runge-Kutta-Munthe-Kaas, SE(3)")
right.set_xticks(counts, [str(n) for n in counts])
right.minorticks_off()
for axes in (left, right):
    axes.legend()
    axes.grid(alpha=0.3)
figure.savefig(figure_file, dpi=110)
print(f"\nfigure: {figure_file}")
