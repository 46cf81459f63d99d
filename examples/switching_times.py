"""Crane without swing: the fastest move of a load, with the exact switching times of its bang-bang force.

The force is at its limits and jumps between them. With free node times the nodes move to the jumps, so four intervals
are enough. Such long intervals need an integration method of high order.
"""

import jax
import numpy as np

import twistax as tx

jax.config.update("jax_enable_x64", True)

STIFFNESS = 4.0  # of the pendulum, 1/s2: linear for small angles
x, v = tx.State("x"), tx.State("v")
a, w = tx.State("a"), tx.State("w")
force = tx.Control("force", min=-1.0, max=1.0)
crane = tx.compile(tx.System(rates={x: v, v: force, a: w, w: -STIFFNESS * a - force}))
rest = {v: 0.0, a: 0.0, w: 0.0}

problem = tx.trajectory.Problem(
    crane,
    tx.Minimize(tx.Time()),
    nodes=tx.trajectory.Mesh(5, free=True),
    final_time=(1.0, 10.0),
    initial={x: 0.0, **rest},
    final={x: 2.0, **rest},
    guess={force: [1.0, -1.0, 1.0, -1.0]},
    method=tx.RKMK(tx.tableaus.DOP853),
)
result = problem.solve()
print(result.message)
print(f"{result.final_time:.6f} s; force {np.round(result.us['force'], 3)} from {np.round(result.ts[:-1], 6)} s on")

flown = tx.integrate(
    crane,
    {name: values[0] for name, values in result.xs.items()},
    t1=result.final_time,
    rtol=1e-9,
    atol=1e-9,
    u=result.controls,
    save_at=[result.final_time],
)
for name, values in flown.xs.items():
    print(f"  {name} {float(values[-1]): .6f}, planned {float(result.xs[name][-1]): .6f}")

figure = result.plot(units={"x": "m", "v": "m/s", "a": "rad", "w": "rad/s", "force": "N/kg"})
figure.savefig("switching_times.png", dpi=90)
