"""A Stewart platform on six legs with springs: its motion, the error of its loop closure, and the force in one leg."""

import jax
import numpy as np
from matplotlib import pyplot as plt

import twistax as tx
from twistax.mechanics import (
    Drive,
    Link,
    Mechanism,
    SpatialInertia,
    joint_wrench,
    joints,
    loop_gap,
    loop_wrenches,
    loops,
)

jax.config.update("jax_enable_x64", True)

# ---- six legs from the ground to a plate: a universal joint, a slide on a spring, a ball -----------------------------
height, tube_length, stiffness, preload = 0.8, 0.5, 4e3, 0.02
sides = 2.0 * np.pi / 3.0 * np.arange(3)
below, above = (np.concatenate([[a - half, a + half] for a in sides]) for half in (0.3, 0.8))
feet = np.stack([np.cos(below), np.sin(below), 0.0 * below], axis=1)
tops = 0.6 * np.stack([np.cos(above), np.sin(above), 0.0 * above], axis=1)
plate = SpatialInertia(mass=20.0, inertia=np.diag([1.8, 1.8, 3.6]))
tube = SpatialInertia(mass=2.0, center_of_mass=(0.0, 0.0, 0.25), inertia=np.diag([0.04, 0.04, 0.001]))
rod = SpatialInertia(mass=1.0, center_of_mass=(0.0, 0.0, -0.2), inertia=np.diag([0.02, 0.02, 0.001]))

links, closures, angles = [Link(joints.Free("plate"), plate, np.eye(4))], [], []
for i, (foot, top) in enumerate(zip(feet, tops, strict=True)):
    way = top + [0.0, 0.0, height] - foot
    length = np.linalg.norm(way)
    first, second = joints.universal(f"foot_{i}", (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    spring = Drive(stiffness=stiffness, rest=length - tube_length + preload)
    slide = joints.Prismatic(f"leg_{i}", (0.0, 0.0, 1.0))
    links += [
        Link(first, None, tx.pose(position=foot)),
        Link(second, tube, np.eye(4), parent=first.name, name=f"tube_{i}"),
        Link(slide, rod, tx.pose(position=[0.0, 0.0, tube_length]), parent=f"tube_{i}", drive=spring),
        Link(joints.Fixed(f"ball_{i}"), None, tx.pose(position=top), parent="plate"),
    ]
    closures.append(loops.PointLoop(f"closure_{i}", f"leg_{i}", f"ball_{i}"))
    x, y, z = way / length
    angles += [-np.arctan2(y, z), np.arcsin(x), length - tube_length]
platform = Mechanism(links, loops=closures, driven=[])

# ---- what is asked of it: the wrench that the first leg's slide carries, in the leg ----------------------------------
pushes = []
for i in range(6):
    slide = platform.segment_of(f"leg_{i}")
    pushes.append(slide.link.drive.passive(platform.q["q"][slide.coordinates][0], platform.qd[slide.freedoms[0]]))
slides = [platform.segment_of(f"leg_{i}").freedoms[0] for i in range(6)]
springs = np.eye(platform.dofs)[:, slides] @ tx.Concat(*pushes)
system = platform.system()
outputs = {
    "energy": platform.energy(),
    "gap": tx.Concat(*(loop_gap(platform, loop.name) for loop in closures)),
    "carried": joint_wrench(
        platform, "leg_0", qdd=system.rates["qd"], wrenches=loop_wrenches(platform, tau=springs), frame="leg_0"
    ),
    "pushed": pushes[0],
    "plate": platform.pose("plate")[:3, 3],
}
dynamics = tx.compile(platform.system(outputs=outputs))
shaken = np.concatenate([[0.3, 0.0, 0.5, 0.0, 0.4, 1.0], np.zeros(18)])  # the plate's body twist, m/s and rad/s
guess = {"q": np.array(angles), "plate_position": tx.pose(position=[0.0, 0.0, height]), "qd": shaken}
start = dynamics.project(0.0, guess)  # the legs' rates follow from the plate's twist

times = np.linspace(0.0, 2.0, 201)
sol = tx.integrate(dynamics, start, t1=times[-1], rtol=1e-10, atol=1e-10, save_at=times)
found = jax.vmap(dynamics.outputs)(sol.ts, sol.xs)
open_by, energy = np.abs(found["gap"]).max(), np.asarray(found["energy"])
drift = np.ptp(energy) / np.abs(energy).max()
print(f"{platform}: {sum(loop.rows for loop in closures)} closures")
print(f"{sol.stats.accepted} steps; the loops open by {open_by:.1e} m, energy drifts by {drift:.1e}")
force, torque = np.asarray(found["carried"])[:, :3], np.asarray(found["carried"])[:, 3:]
print(f"along the leg its spring pushes with {force[:, 2].min():.0f} to {force[:, 2].max():.0f} N")
print(f"across, its tube guides it with up to {np.linalg.norm(force[:, :2], axis=1).max():.1f} N")
print(f"and holds it with up to {np.linalg.norm(torque, axis=1).max():.1f} N m")
off = np.abs(force[:, 2] - found["pushed"]).max()
if open_by > 1e-10 or drift > 1e-8 or off > 1e-9 * np.abs(force).max():
    raise SystemExit("the loops open, the energy drifts, or the leg does not carry the force of its spring")

figure, (left, right) = plt.subplots(1, 2, figsize=(9.0, 3.0), layout="constrained")
left.plot(times, (np.asarray(found["plate"]) - [0.0, 0.0, height]) * 1e3, label=["x", "y", "z"])
left.set(xlabel="t (s)", ylabel="plate off its start (mm)")
left.legend()
right.plot(times, force, label=["x", "y", "along the leg"])
right.set(xlabel="t (s)", ylabel="force carried in the leg (N)")
right.legend()
figure.savefig("stewart.png", dpi=100)
