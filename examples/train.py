"""Systems of systems: an engine with a lag pulls three wagons on springs, joined from copies of two small systems."""

import jax
import numpy as np
from matplotlib import pyplot as plt

import twistax as tx

jax.config.update("jax_enable_x64", True)

p, v, F = tx.State("p"), tx.State("v"), tx.Control("F")  # m, m/s, N
m, drag = tx.Parameter("m", value=500.0), tx.Parameter("drag", value=20.0)  # kg, N s/m
wagon = tx.System(rates={p: v, v: (F - drag * v) / m}, outputs={"momentum": m * v})

pull, command = tx.State("pull"), tx.Control("command", min=0.0, max=900.0)  # N
engine = tx.System(rates={pull: (command - pull) / 0.8}, outputs={"force": pull})

wagons = [wagon.renamed(f"{k}_", keep=["m", "drag"]) for k in range(3)]
positions, speeds = [w.states[0] for w in wagons], [w.states[1] for w in wagons]


def coupling(k):
    """The force of the spring and damper between wagons k and k + 1, N."""
    return 4e3 * (positions[k] - positions[k + 1]) + 600.0 * (speeds[k] - speeds[k + 1])


forces = {
    "0_F": engine.output("force") - coupling(0),
    "1_F": coupling(0) - coupling(1),
    "2_F": coupling(1),
}
momentum = sum(w.output(f"{k}_momentum") for k, w in enumerate(wagons))
train = tx.join(engine, *wagons, connect=forces, outputs={"total": momentum})
dynamics = tx.compile(train)
print(train)

start = {state.name: 0.0 for state in train.states}
times = np.linspace(0.0, 12.0, 121)
rest = {"0_v": 0.0, "1_v": 0.0, "2_v": 0.0}
run = tx.integrate(
    dynamics,
    start,
    t1=12.0,
    rtol=1e-9,
    atol=1e-9,
    u={"command": tx.ZeroOrderHold([0.0, 6.0], [900.0, 0.0])},
    save_at=times,
)

# Springs pull both ways: only the engine and the drag change the momentum of all.
total = run.outputs["total"]
impulse = np.trapezoid(run.xs["pull"] - 20.0 * sum(run.xs[name] for name in rest), times)
print(f"momentum at the end {total[-1]:.1f} N s, impulse of engine and drag {impulse:.1f} N s")
if abs(total[-1] - impulse) > 2.0:
    raise SystemExit("the momentum of the train does not follow from its forces")

figure, axes = plt.subplots(1, 2, figsize=(7.5, 3.0), layout="constrained")
for k in range(3):
    axes[0].plot(times, run.xs[f"{k}_v"], label=f"wagon {k}")
axes[0].set(xlabel="time, s", ylabel="speed, m/s")
axes[0].legend(frameon=False)
axes[1].plot(times, 1e3 * (run.xs["0_p"] - run.xs["1_p"]), label="between 0 and 1")
axes[1].plot(times, 1e3 * (run.xs["1_p"] - run.xs["2_p"]), label="between 1 and 2")
axes[1].set(xlabel="time, s", ylabel="extension of the spring, mm")
axes[1].legend(frameon=False)
figure.savefig("train.png", dpi=100)
