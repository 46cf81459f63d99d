"""Double pendulum: two bars on hinges, released from two initial states that differ by a millionth of a radian.

The motions diverge exponentially, because the system is chaotic. The energy of each is conserved, so the
divergence is not an error of the integrator.
"""

import jax
import numpy as np
from matplotlib import pyplot as plt

import twistax as tx
from twistax.mechanics import Link, Mechanism, SpatialInertia, joints

jax.config.update("jax_enable_x64", True)

# Bars hang along -z; both hinges turn about y.
bar = SpatialInertia(mass=1.0, center_of_mass=(0.0, 0.0, -0.25), inertia=np.diag([0.021, 0.021, 1e-4]))
y, below = (0.0, 1.0, 0.0), tx.pose(position=[0.0, 0.0, -0.5])
arms = Mechanism(
    [
        Link(joints.Revolute("upper", y), bar, np.eye(4)),
        Link(joints.Revolute("lower", y), bar, below, parent="upper"),
        Link(joints.Fixed("tip"), None, below, parent="lower"),
    ]
)
dynamics = tx.compile(arms.system(controls=[], outputs={"tip": arms.pose("tip")[:3, 3], "energy": arms.energy()}))

times = np.linspace(0.0, 12.0, 1201)
paths = []
for offset in (0.0, 1e-6):
    start = {"q": np.array([2.0, 2.5 + offset]), "qd": np.zeros(2)}
    solution = tx.integrate(dynamics, start, t1=12.0, rtol=1e-11, atol=1e-11, save_at=times)
    energy = np.asarray(solution.outputs["energy"])
    print(f"offset {offset:.0e} rad: {int(solution.stats.steps)} steps, energy drifts by {np.ptp(energy):.1e} J")
    paths.append(np.asarray(solution.outputs["tip"]))
apart = np.linalg.norm(paths[0] - paths[1], axis=1)
print(f"tips are {apart[100]:.1e} m apart after 1 s, {apart.max():.2f} m at most")

figure, (left, right) = plt.subplots(1, 2, figsize=(8.0, 3.4), layout="constrained")
left.plot(paths[0][:, 0], paths[0][:, 2], linewidth=0.7)
left.set(xlabel="x of the tip, m", ylabel="z of the tip, m", aspect="equal")
right.semilogy(times[1:], apart[1:])
right.set(xlabel="time, s", ylabel="distance between the tips, m")
figure.savefig("double_pendulum.png", dpi=100)
if np.ptp(energy) > 1e-8 or apart.max() < 0.1:
    raise SystemExit("the energy drifts, or the motions stay close")
