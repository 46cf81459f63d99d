"""Powered descent: the landing of a rocket stage with minimum propellant, checked by simulations with two integrators.

The system has twenty lines of expressions: `twistax.scenes.powered_descent.system`. The full case with a figure is
`python -m twistax demo`.
"""

import diffrax
import jax
import numpy as np

import twistax as tx
from twistax.scenes import powered_descent as scene

jax.config.update("jax_enable_x64", True)

vehicle, start = scene.Lander(), scene.Start(height=600.0, offset=(150.0, 60.0), tilt=np.deg2rad(20.0))
dynamics = tx.compile(scene.system(vehicle))
g, V, m = dynamics.states

problem = tx.trajectory.Problem(
    dynamics,
    objective=tx.Maximize(m),
    nodes=15,
    final_time=(8.0, 20.0),
    final_time_guess=11.0,
    initial=scene.initial(start, vehicle),
    final=[{V: np.zeros(6)}, g[:3, 3] == 0.0, g[:2, 2] == 0.0],
    guess=scene.guess(start, vehicle, nodes=15, final_time=11.0),
)
result = problem.solve()
print(result)
print(f"landed after {result.final_time:.2f} s with {result.cost:,.0f} kg left")

for method in (tx.RKMK(tx.tableaus.RK4), diffrax.Dopri8()):
    replay = result.replay(method)
    end = {name: values[-1] for name, values in replay.xs.items()}
    print(f"{type(method).__name__}: {np.linalg.norm(end['g'][:3, 3]):.4f} m off the pad,", end=" ")
    print(f"at {np.linalg.norm(end['V'][:3]):.4f} m/s; largest violation of a limit:", end=" ")
    worst = max(replay.violations, key=replay.violations.__getitem__)
    print(f"{worst}, by {replay.violations[worst]:.2g}")

figure = result.plot(["g", "T", "m"], units={"T": "N", "m": "kg"})
figure.savefig("landing.png", dpi=90)
