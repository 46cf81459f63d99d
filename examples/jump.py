"""Jump of a quadruped in the sagittal plane: the optimiser decides when the feet leave the ground and where they land.

The trunk is a rigid body, the feet have no mass and move within reach of the hips. Each contact is a complementarity
constraint: gap or normal force is zero. Friction is Coulomb's.
"""

import jax
import numpy as np
from matplotlib import pyplot as plt

import twistax as tx
from twistax.trajectory import Collocation, Contact, Friction, Problem

jax.config.update("jax_enable_x64", True)
MASS, INERTIA, GRAVITY, HIP, REACH, STAND = 12.0, 0.25, 9.81, 0.2, 0.36, 0.3  # kg, kg m2, m/s2, m
TIME, NODES, FAR, STREAM = 0.9, 31, 0.5, 0.06  # s, nodes, m, m: feet are that high over a stream halfway

place, velocity = tx.State("place", (2,)), tx.State("velocity", (2,))
pitch, turn = tx.State("pitch"), tx.State("turn")
rates = {place: velocity, pitch: turn}
constraints, effort, force, torque = {}, 0.0, 0.0, 0.0
feet = {leg: tx.State(f"{leg} foot", (2,)) for leg in ("front", "hind")}
for leg, side in (("front", 1.0), ("hind", -1.0)):
    foot, moving = feet[leg], tx.Control(f"speed of the {leg} foot", (2,), min=-4.0, max=4.0)
    N, f = tx.Control(f"normal force, {leg}", min=0.0, max=400.0), tx.Control(f"friction, {leg}")
    arm = foot - place
    rates[foot] = moving
    constraints[leg] = Contact(foot[1], N, Friction(0.6, force=f, velocity=moving[0]))
    hip = place + side * HIP * tx.Concat(tx.Cos(pitch), -tx.Sin(pitch))
    constraints[f"{leg} leg"] = (foot - hip) @ (foot - hip) <= REACH**2
    constraints[f"{leg} hip"] = hip[1] - foot[1] >= 0.12
    force, torque = force + tx.Concat(f, N), torque + arm[1] * f - arm[0] * N
    effort = effort + 1e-4 * (N * N + f * f) + 1e-2 * (moving @ moving)
rates |= {velocity: force / MASS - np.array([0.0, GRAVITY]), turn: torque / INERTIA}
dynamics = tx.compile(tx.System(rates=rates, constraints=constraints))


def standing(x):
    at_feet = {"front foot": [x + HIP, 0.0], "hind foot": [x - HIP, 0.0]}
    return {"place": [x, STAND], "velocity": [0.0, 0.0], "pitch": 0.0, "turn": 0.0, **at_feet}


problem = Problem(
    dynamics,
    tx.Minimize(running=effort),
    nodes=NODES,
    final_time=TIME,
    initial=standing(0.0),
    final=standing(FAR),
    at={node: [foot[1] >= STREAM for foot in feet.values()] for node in range(13, 18)},
    guess={f"normal force, {leg}": 0.5 * MASS * GRAVITY for leg in feet},
    transcription=Collocation(tx.tableaus.RADAU_IIA1),
)
result = problem.solve(mesh_tolerance=np.inf)  # impacts take one interval: no mesh makes them exact
left = max(result.complementarity.values())
print(f"{result.status.name}, {result.iterations} iterations, cost {result.cost:.4f}, largest product left {left:.1e}")
if not result.solved:
    raise SystemExit(result.message)

figure, (above, below) = plt.subplots(2, 1, sharex=True, figsize=(7.0, 4.0), layout="constrained")
for k, (leg, foot) in enumerate(feet.items()):
    above.plot(result.ts, result.xs[foot.name][:, 1], f"C{k}", label=f"{leg} foot")
    below.step(result.ts, np.append(result.us[f"normal force, {leg}"], np.nan), f"C{k}", where="post")
    flying = result.us[f"normal force, {leg}"] < 1.0
    print(f"the {leg} foot flies for {flying.sum() * TIME / (NODES - 1):.2f} s")
above.plot(result.ts, result.xs["place"][:, 1] - STAND, "k--", label="trunk, from where it stands")
above.set(ylabel="height, m")
below.set(xlabel="t, s", ylabel="normal force, N")
above.legend()
figure.savefig("jump.png", dpi=100)
