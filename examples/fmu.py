"""A tumbling satellite as an FMU: written by twistax, simulated by FMPy, and compared with `tx.integrate`.

The FMU exchanges the attitude as a unit quaternion. Co-simulation takes the steps of `tx.integrate` in C.
"""

import importlib.util
import shutil
import tempfile
from pathlib import Path

import jax
import numpy as np
from matplotlib import pyplot as plt

import twistax as tx

jax.config.update("jax_enable_x64", True)
END, DT = 20.0, 0.02  # s

R = tx.State("R", group=tx.SO3, kind=tx.kinds.Rotation("world", "body"))
w = tx.State("w", (3,), kind=tx.FreeVector("body"), unit="rad/s")
torque = tx.Control("torque", (3,), kind=tx.FreeVector("body"), unit="N m")
J = tx.Parameter("J", value=np.diag([1.0, 2.0, 3.0]), kind=tx.kinds.Inertia("body"))
energy = 0.5 * (w @ (J @ w))
rates = {R: w, w: tx.linalg.Solve(J, torque - tx.linalg.Cross(w, J @ w))}
satellite = tx.compile(tx.System(rates=rates, outputs={"energy": energy}))

x0 = {"R": np.eye(3), "w": np.array([0.05, 1.0, 0.0])}  # about the middle axis: it turns over and over
u = {"torque": np.zeros(3)}
save_at = np.linspace(0.0, END, 201)
rk4 = tx.RKMK(tx.tableaus.RK4)
ours = tx.integrate(satellite, x0, t1=END, dt=DT, method=rk4, u=u, save_at=save_at)
columns = {column.name: column.values for column in tx.columns.Columns().columns(ours)}
print(f"twistax: energy {ours.outputs['energy'][-1]:.6f} J at the end")

figure, axes = plt.subplots(figsize=(7.0, 3.0), layout="constrained")
axes.plot(save_at, ours.xs["w"], label=["$\\omega_x$", "$\\omega_y$", "$\\omega_z$"])
if shutil.which("cc") and importlib.util.find_spec("fmpy"):
    import fmpy

    unit = satellite.to_fmu(Path(tempfile.mkdtemp()) / "satellite.fmu", x0, u, steps=rk4, dt=DT)
    description = fmpy.read_model_description(str(unit))
    print(f"satellite.fmu: {len(description.modelVariables)} variables, FMI {description.fmiVersion}")
    names = ["R.qw", "R.qx", "R.qy", "R.qz", "w[0]", "w[1]", "w[2]", "energy"]
    options = {"stop_time": END, "output_interval": save_at[1], "output": names}
    steps = fmpy.simulate_fmu(str(unit), fmi_type="CoSimulation", **options)
    exchange = fmpy.simulate_fmu(str(unit), fmi_type="ModelExchange", relative_tolerance=1e-10, **options)
    turned = np.abs(sum(steps[name] * columns[name] for name in names[:4]))  # 1 where the attitudes agree
    apart = max(np.abs(steps[name] - columns[name]).max() for name in names[4:])
    apart = max(apart, np.abs(1.0 - turned).max())
    print("co-simulation agrees with tx.integrate to 1e-9" if apart < 1e-9 else f"they are {apart:.0e} apart")
    print(f"model exchange, CVode: energy {exchange['energy'][-1]:.6f} J at the end")
    axes.plot(steps["time"], [list(row) for row in steps[names[4:7]]], "k:", label=["FMPy", "", ""])
axes.set(xlabel="t, s", ylabel="body rate, rad/s")
axes.legend(loc="upper right")
figure.savefig("fmu.png", dpi=100)
