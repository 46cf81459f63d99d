"""Receding horizon: a quadrotor flies between two pillars in gusts, with a warm-started solve every 50 ms.

Each solve is over one second, and starts from the last plan, shifted by one interval. The problem compiles once.
"""

import jax
import numpy as np
from matplotlib import pyplot as plt

import twistax as tx

jax.config.update("jax_enable_x64", True)
INTERVAL, NODES, STEPS = 0.05, 20, 60
mass, J, arm, drag = 0.8, np.diag([5e-3, 5e-3, 9e-3]), 0.17, 0.016  # kg, kg m2, m, m (rotor drag per thrust)
mixer = np.array([[1, 1, 1, 1], [0, arm, 0, -arm], [-arm, 0, arm, 0], [drag, -drag, drag, -drag]], float)
hover = mass * 9.81 / 4
PILLARS = [((1.2, 0.25), 0.5), ((2.6, -0.3), 0.5)]  # places and radii, m
GOAL = np.array([4.0, 0.0, 1.0])

g, V = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,))
rotors = tx.Control("rotors", shape=(4,), min=0.3, max=4.5)  # thrusts, N
inside = tx.Control("inside", min=0.0)  # how far a gust may blow it into a pillar, m2: limits that always can be met
gust = tx.Parameter("gust", value=np.zeros(3))  # force in the world's frame, N
lift = mixer @ rotors
force = g[:3, :3].T @ (np.array([0.0, 0.0, -9.81 * mass]) + gust) + tx.Concat(0.0, 0.0, lift[0])
M = np.block([[mass * np.eye(3), np.zeros((3, 3))], [np.zeros((3, 3)), J]])
momentum = tx.lie.AdjointDual(V, M @ V)
system = tx.System(
    rates={g: V, V: tx.linalg.Solve(M, tx.lie.wrench(force=force, torque=lift[1:]) - momentum)},
    constraints={
        f"pillar {k}": (g[0, 3] - x) ** 2 + (g[1, 3] - y) ** 2 + inside >= radius**2
        for k, ((x, y), radius) in enumerate(PILLARS)
    },
)
dynamics = tx.compile(system)

away, effort = g[:3, 3] - GOAL, rotors - hover
problem = tx.trajectory.Problem(
    dynamics,
    tx.Minimize(
        5.0 * (away @ away) + V @ V,
        running=away @ away + 0.2 * (V @ V) + 0.2 * (effort @ effort) + 1000.0 * inside,
    ),
    nodes=NODES,
    substeps=1,
    final_time=INTERVAL * (NODES - 1),
    initial={g: tx.pose(position=[0.0, 0.05, 1.0]), V: np.zeros(6)},
    guess={rotors: np.full(4, hover), g: tx.pose(position=[0.0, 0.05, 1.0])},
)

rng = np.random.default_rng(0)
plan = problem.solve()
print(plan.message)
x, wind, path, iterations = {"g": plan.xs["g"][0], "V": plan.xs["V"][0]}, np.zeros(3), [plan.xs["g"][0][:3, 3]], []
for _ in range(STEPS):
    # The vehicle flies the first interval of the plan, in wind that changes all the time.
    wind = 0.8 * wind + 0.25 * rng.normal(size=3)
    u = {name: values[0] for name, values in plan.us.items()}
    flown = tx.integrate(dynamics, x, t1=INTERVAL, dt=INTERVAL / 5, u=u, params={"gust": wind})
    x = {name: np.asarray(values[-1]) for name, values in flown.xs.items()}
    path.append(x["g"][:3, 3])
    plan = problem.solve(warm=plan.shifted(), initial=x)
    iterations.append(plan.iterations)
path = np.array(path)
clearance = min((np.hypot(*(path[:, :2] - place).T) - radius).min() for place, radius in PILLARS)
print(f"{np.median(iterations):.0f} iterations a step, least clearance {clearance:.3f} m;", end=" ")
print(f"{np.linalg.norm(path[-1] - GOAL):.2f} m from the goal after {STEPS * INTERVAL:.1f} s")

figure, axes = plt.subplots(figsize=(7.0, 3.0), layout="constrained")
for place, radius in PILLARS:
    axes.add_patch(plt.Circle(place, radius, color="0.8"))
axes.plot(path[:, 0], path[:, 1], ".-", label="flown")
axes.plot(*plan.xs["g"][:, :2, 3].T, "--", label="last plan")
axes.plot(*GOAL[:2], "x", label="goal")
axes.set(xlabel="x, m", ylabel="y, m", aspect="equal")
axes.legend(frameon=False)
figure.savefig("receding_horizon.png", dpi=100)
if clearance < -0.05:  # a slack has a price here, and gusts are not foreseen
    raise SystemExit("it flew into a pillar")
