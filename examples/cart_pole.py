"""Cart-pole swing-up: the push with the least effort that brings the pole upright within two seconds.

Parameters are those of Kelly, An introduction to trajectory optimization, SIAM Review 59 (2017), section 6.
"""

import jax
import numpy as np

import twistax as tx

jax.config.update("jax_enable_x64", True)

M, m, l, g = 1.0, 0.3, 0.5, 9.81  # cart and pole, kg; length, m; m/s2
x, a = tx.State("x", min=-2.0, max=2.0, unit="m"), tx.State("a", unit="rad")  # place of the cart; angle from hanging
xd, ad = tx.State("xd", unit="m/s"), tx.State("ad", unit="rad/s")
push = tx.Control("push", min=-20.0, max=20.0, unit="N")
s, c = tx.Sin(a), tx.Cos(a)
free = M + m * s**2
cart_pole = tx.compile(
    tx.System(
        rates={
            x: xd,
            a: ad,
            xd: (l * m * s * ad**2 + push + m * g * c * s) / free,
            ad: -(l * m * c * s * ad**2 + push * c + (m + M) * g * s) / (l * free),
        }
    )
)
problem = tx.trajectory.Problem(
    cart_pole,
    tx.Minimize(running=push**2),
    nodes=41,
    final_time=2.0,
    initial={x: 0.0, a: 0.0, xd: 0.0, ad: 0.0},
    final={x: 1.0, a: np.pi, xd: 0.0, ad: 0.0},
    controls=tx.trajectory.Linear(),
)
result = problem.solve()
print(result.message)
print(f"effort {result.cost:.2f} N2 s, published 58.8 N2 s; largest push {np.abs(result.us['push']).max():.1f} N")
error = result.replay().xs["a"][-1] - np.pi
print(f"a rollout of the push ends {np.rad2deg(abs(float(error))):.3f} degrees from upright")

figure = result.plot(units={"x": "m", "a": "rad", "xd": "m/s", "ad": "rad/s", "push": "N"})
figure.savefig("cart_pole.png", dpi=90)
if not result.solved:
    raise SystemExit("the solve found no optimum")
