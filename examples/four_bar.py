"""Four-bar linkage: the motion of a closed kinematic loop, and the constraint force in its pin."""

import jax
import numpy as np
from matplotlib import pyplot as plt

import twistax as tx
from twistax.mechanics import (
    Link,
    Mechanism,
    SpatialInertia,
    joints,
    loop_gap,
    loop_wrench,
    loops,
)

jax.config.update("jax_enable_x64", True)


def rod(length, mass=1.0, axis=0):
    """A thin rod from the origin along an axis."""
    center, across = length / 2 * np.eye(3)[axis], mass * length**2 / 12
    return SpatialInertia(
        mass=mass, center_of_mass=center, inertia=across * np.eye(3) - 0.99 * across * np.diag(np.eye(3)[axis])
    )


def at(x, y=0.0, z=0.0):
    return tx.pose(position=[x, y, z])


# ---- a four-bar linkage: crank, coupler and rocker in the plane of x and z, closed by a hinge -----------------------
axis = (0.0, 1.0, 0.0)
linkage = Mechanism(
    [
        Link(joints.Revolute("crank", axis), rod(0.4), at(0.0)),
        Link(joints.Revolute("coupler", axis), rod(1.0), at(0.4), parent="crank"),
        Link(joints.Fixed("pin"), None, at(1.0), parent="coupler"),
        Link(joints.Revolute("rocker", axis), rod(0.8), at(0.9)),
        Link(joints.Fixed("tip"), None, at(0.8), parent="rocker"),
    ],
    loops=[loops.PointLoop("closure", "pin", "tip")],
)
four_bar = tx.compile(
    linkage.system(
        controls=[],
        outputs={
            "energy": linkage.energy(),
            "gap": loop_gap(linkage, "closure"),
            "force": loop_wrench(linkage, "closure", frame="base")[:3],
            "pin": linkage.pose("pin")[:3, 3],
        },
    )
)
guess = {"q": np.array([-0.9, 0.4, -1.3]), "qd": np.array([6.0, 0.0, 0.0])}

times = np.linspace(0.0, 2.0, 101)
sol = tx.integrate(four_bar, four_bar.project(0.0, guess), t1=times[-1], dt=5e-4, save_at=times)
found = jax.vmap(four_bar.outputs)(sol.ts, sol.xs)
open_by, energy = np.abs(found["gap"]).max(), np.asarray(found["energy"])
drift = np.ptp(energy) / energy.max()
print(f"{sol.stats.accepted} steps; the loop opens by {open_by:.1e} m, energy drifts by {drift:.1e}")
print("notes:", *linkage.notes)
print("the pin carries at the end (N):", np.round(found["force"][-1], 2))
if open_by > 1e-10 or drift > 1e-8:
    raise SystemExit("the loop opens, or the energy drifts")

figure, (left, right) = plt.subplots(1, 2, figsize=(9.0, 3.0), layout="constrained")
left.plot(found["pin"][:, 0], found["pin"][:, 2])
left.set(xlabel="x (m)", ylabel="z (m)", title="path of the pin", aspect="equal")
right.plot(times, found["force"][:, [0, 2]], label=["x", "z"])
right.set(xlabel="t (s)", ylabel="force on the pin (N)")
right.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
figure.savefig("four_bar.png", dpi=100)
