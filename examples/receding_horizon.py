"""A quadrotor between two pillars, in gusts that it does not foresee: every 50 ms a warm solve over the next second.

The problem compiles once. Each step starts from the last plan, moved on by one interval with its multipliers.
"""

import sys
import time

import jax
import numpy as np

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
x, wind, times, iterations = {"g": plan.xs["g"][0], "V": plan.xs["V"][0]}, np.zeros(3), [], []
path, clearance = [x["g"][:3, 3]], np.inf
for _ in range(STEPS):
    # The vehicle flies the first interval of the plan, in wind that changes all the time.
    wind = 0.8 * wind + 0.25 * rng.normal(size=3)
    flight = tx.integrate(
        dynamics, x, t1=INTERVAL, dt=INTERVAL / 5, u={name: u[0] for name, u in plan.us.items()}, params={"gust": wind}
    )
    x = {name: np.asarray(values[-1]) for name, values in flight.xs.items()}
    path.append(x["g"][:3, 3])
    clearance = min(clearance, *(np.hypot(*(path[-1][:2] - place)) - radius for place, radius in PILLARS))
    begin = time.perf_counter()
    plan = problem.solve(warm=plan.shifted(), initial=x)
    times.append(time.perf_counter() - begin)
    iterations.append(plan.iterations)
    if not plan.solved:
        print(plan.message)

# The first warm solve compiled its start.
milliseconds, left = 1e3 * np.array(times[1:]), np.linalg.norm(path[-1] - GOAL)
print(
    f"step: {np.median(milliseconds):.0f} ms, at most {milliseconds.max():.0f}; {np.median(iterations):.0f} iterations"
)
print(f"{left:.2f} m from the goal after {STEPS * INTERVAL:.1f} s; least clearance {clearance:.3f} m")
if clearance < -0.05:  # room is a matter of price here, and gusts are not foreseen
    raise SystemExit("it flew into a pillar")

if "--picture" in sys.argv:
    import matplotlib.pyplot as plt

    axes = plt.figure(figsize=(7.0, 3.0)).add_subplot(aspect="equal", xlabel="x (m)", ylabel="y (m)")
    for place, radius in PILLARS:
        axes.add_patch(plt.Circle(place, radius, color="0.8"))
    axes.plot(*np.array(path).T[:2], ".-", label="flown")
    axes.plot(*plan.xs["g"][:, :2, 3].T, "--", label="last plan")
    axes.plot(*GOAL[:2], "x", label="goal")
    axes.legend()
    axes.figure.savefig("receding_horizon.png", dpi=150, bbox_inches="tight")
