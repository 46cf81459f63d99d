"""From problem to flight code: a quadrotor flies past two pillars, with a controller at 100 Hz in Python and in C.

Both take two iterations of the solver in each sampling period of 10 ms, and their closed loops agree to rounding.
"""

import ctypes
import shutil
import subprocess
import tempfile

import jax
import numpy as np
from matplotlib import pyplot as plt

import twistax as tx

jax.config.update("jax_enable_x64", True)
PERIOD, STEPS = 0.01, 250  # a plan has 19 intervals of five periods
mass, arm, drag = 0.8, 0.17, 0.016  # kg, m, m (rotor drag per thrust)
mixer = np.array([[1, 1, 1, 1], [0, arm, 0, -arm], [-arm, 0, arm, 0], [drag, -drag, drag, -drag]], float)
hover = mass * 9.81 / 4
PILLARS, GOAL = [((1.2, 0.25), 0.5), ((2.6, -0.3), 0.5)], np.array([4.0, 0.0, 1.0])  # places and radii, m

g, V, rotors = (
    tx.State("g", group=tx.SE3),
    tx.State("V", shape=(6,)),
    tx.Control("rotors", shape=(4,), min=0.3, max=4.5),
)
lift = mixer @ rotors
force = g[:3, :3].T @ np.array([0.0, 0.0, -9.81 * mass]) + tx.Concat(0.0, 0.0, lift[0])
M = np.diag([mass] * 3 + [5e-3, 5e-3, 9e-3])
wrench = tx.lie.wrench(force=force, torque=lift[1:])
dynamics = tx.compile(tx.System(rates={g: V, V: tx.linalg.Solve(M, wrench - tx.lie.AdjointDual(V, M @ V))}))
away, effort = g[:3, 3] - GOAL, rotors - hover
near = sum(20.0 * tx.Exp(10.0 * (r + 0.1 - tx.linalg.Norm(g[:2, 3] - np.array(place)))) for place, r in PILLARS)
start = {"g": np.asarray(tx.pose(position=[0.0, 0.05, 1.0])), "V": np.zeros(6)}
cost = tx.Minimize(5.0 * (away @ away) + V @ V, running=away @ away + 0.2 * (V @ V + effort @ effort) + near)
mesh = {"nodes": 20, "final_time": 95 * PERIOD, "substeps": 1}
problem = tx.trajectory.Problem(dynamics, cost, **mesh, initial=start)
controller = problem.controller(max_iterations=2)
files = controller.to_c(tempfile.mkdtemp(), name="quadrotor")
fly = tx.simulator(dynamics, start, t1=PERIOD, dt=PERIOD / 2, u={"rotors": np.full(4, hover)})


def loop(feedback, shift):
    x, path = start, []
    for k in range(STEPS):
        x = {name: np.asarray(values[-1]) for name, values in fly(x, u={"rotors": feedback(x)}).xs.items()}
        path.append(x["g"][:3, 3])
        if k % 5 == 4:
            shift()
    return np.array(path)


path = loop(lambda x: controller.feedback(x)["rotors"], controller.shift)
clearance = min((np.hypot(*(path[:, :2] - place).T) - radius).min() for place, radius in PILLARS)
print(f"clearance {clearance:.2f} m, {np.linalg.norm(path[-1] - GOAL):.2f} m from the goal; {controller.log}")
if shutil.which("cc"):
    library = str(files.source.with_suffix(".so"))
    subprocess.run(["cc", "-std=c99", "-O1", "-shared", "-fPIC", str(files.source), "-lm", "-o", library], check=True)
    code, memory = ctypes.CDLL(library), np.zeros(300_000)  # doubles: the header states how many it needs
    point = lambda a: ctypes.c_void_p(a.ctypes.data)  # noqa: E731
    code.quadrotor_init(point(memory))

    def in_c(x):
        values, u = [np.ascontiguousarray(a) for a in (x["g"], x["V"])], np.zeros(4)
        code.quadrotor_feedback(point(memory), *map(point, values), point(u), None, None, None)
        return u

    apart = np.abs(loop(in_c, lambda: code.quadrotor_shift(point(memory))) - path).max()
    print("the loop in C is the same to 1e-9 m" if apart < 1e-9 else f"the loop in C is {apart:.0e} m apart")
figure, axes = plt.subplots(figsize=(7.0, 3.0), layout="constrained")
for place, radius in PILLARS:
    axes.add_patch(plt.Circle(place, radius, color="0.8"))
axes.plot(path[:, 0], path[:, 1])
axes.set(xlabel="x, m", ylabel="y, m", aspect="equal")
figure.savefig("flight_code.png", dpi=100)
