"""Two-stage rocket: the ascent to a circular orbit with the largest final mass, as one problem of two phases.

The empty first stage separates between the phases. Motion is planar, over a round Earth with an exponential atmosphere.
"""

import jax
import numpy as np

import twistax as tx

jax.config.update("jax_enable_x64", True)

MU, RADIUS, G0 = 3.986e14, 6.378e6, 9.80665  # m3/s2, m, m/s2
KM, KMS = 1e3, 1e3
# thrust, N; exhaust speed, m/s; lift-off mass, propellant and dry mass that falls off, kg
FIRST, SECOND = (7.6e6, 2770.0, 549e3, 410e3, 22e3), (0.93e6, 3400.0)
TARGET = 300e3  # altitude of the orbit, m

h, s = tx.State("h", scale=100 * KM), tx.State("s", scale=500 * KM)  # altitude, m; ground track, m
vr, vt = tx.State("vr", scale=KMS), tx.State("vt", scale=5 * KMS)  # up and along, m/s
m = tx.State("m", min=5e3, scale=1e5)  # kg
pitch = tx.Control("pitch", min=-0.5, max=np.pi / 2, guess=0.8)  # of the thrust over the horizon, rad


def stage(thrust, exhaust):
    r, speed = RADIUS + h, tx.Sqrt(vr**2 + vt**2 + 1.0)
    drag = 0.5 * 1.225 * tx.Exp(-h / 7.2e3) * 0.3 * 10.5 * speed  # N per m/s
    return tx.compile(
        tx.System(
            rates={
                h: vr,
                s: vt * RADIUS / r,
                vr: (thrust * tx.Sin(pitch) - drag * vr) / m - MU / r**2 + vt**2 / r,
                vt: (thrust * tx.Cos(pitch) - drag * vt) / m - vr * vt / r,
                m: -thrust / exhaust,
            }
        )
    )


burn = FIRST[3] * FIRST[1] / FIRST[0]  # s
orbit = np.sqrt(MU / (RADIUS + TARGET))  # m/s
Phase = tx.trajectory.Phase
problem = tx.trajectory.Problem(
    [
        Phase(
            stage(*FIRST[:2]), name="first", nodes=21, final_time=burn,
            initial={h: 0.0, s: 0.0, vr: 0.0, vt: 0.0, m: FIRST[2]},
            guess={h: np.linspace(0.0, 70e3, 21), vr: np.linspace(0.0, 1e3, 21), vt: np.linspace(0.0, 2e3, 21),
                   m: np.linspace(FIRST[2], FIRST[2] - FIRST[3], 21)},
        ),
        Phase(
            stage(*SECOND), tx.Maximize(m), name="second", nodes=25, final_time=(200.0, 420.0),
            final={h: TARGET, vr: 0.0, vt: orbit},
            guess={h: np.linspace(70e3, TARGET, 25), vr: np.linspace(1e3, 0.0, 25), vt: np.linspace(2e3, orbit, 25),
                   m: np.linspace(117e3, 20e3, 25)},
        ),
    ],
    links=[{m: m - FIRST[4]}],
)  # fmt: skip
result = problem.solve()
print(result.message)
last = result.phases[1]
print(f"second stage burns {result.durations['second']:.1f} s; {last.xs['m'][-1]:,.0f} kg reach the orbit")

figure = result.plot(["h", "vt", "m", "pitch"], units={"h": "m", "vt": "m/s", "m": "kg", "pitch": "rad"})
figure.savefig("ascent.png", dpi=90)
if not result.solved:
    raise SystemExit("the solve found no optimum")
