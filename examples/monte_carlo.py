"""Monte Carlo: landing points of a spinning ball with random launch, drag and wind, in a sweep that can be resumed.

python examples/monte_carlo.py                                              # 2,000 throws
python examples/monte_carlo.py --count 1000000 --directory out/throws       # stop it and call it again
python examples/monte_carlo.py --count 1000000 --device gpu                  # all CUDA devices of this machine
"""

from __future__ import annotations

import argparse

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib import pyplot as plt

import twistax as tx

jax.config.update("jax_enable_x64", True)

r, v = tx.State("r", shape=(3,)), tx.State("v", shape=(3,))  # position, m; velocity, m/s
wind = tx.Parameter("wind", shape=(3,))  # of the air, m/s
drag = tx.Parameter("drag")  # rho A Cd / (2 m), 1/m
spin = tx.Parameter("spin", shape=(3,))  # rho A Cl / (2 m) times the unit vector of the spin, 1/m
air = v - wind
speed = tx.Sqrt(air @ air + 1e-12)
gravity = np.array([0.0, 0.0, -9.80665])  # m/s2
ball = tx.System(rates={r: v, v: gravity - drag * speed * air + speed * tx.linalg.Cross(spin, air)})
dynamics = tx.compile(ball)
landed = tx.Event(r[2], direction=-1)


def throw(key: jax.Array) -> dict[str, jax.Array]:
    """Launch, air and ball, each with its scatter."""
    keys = jax.random.split(key, 5)
    direction, elevation = 0.02 * jax.random.normal(keys[0]), jnp.radians(35.0 + jax.random.normal(keys[1]))
    flat = jnp.cos(elevation) * jnp.array([jnp.cos(direction), jnp.sin(direction), 0.0])
    launch = (40.0 + 0.5 * jax.random.normal(keys[2])) * (flat + jnp.array([0.0, 0.0, 1.0]) * jnp.sin(elevation))
    return {
        "v": launch,
        "wind": jnp.append(2.0 * jax.random.normal(keys[3], (2,)), 0.0),
        "drag": 0.005 * jnp.exp(0.05 * jax.random.normal(keys[4])),
    }


def run(member: dict[str, jax.Array]) -> tuple[tx.Solution, dict[str, jax.Array]]:
    params = {"wind": member["wind"], "drag": member["drag"], "spin": np.array([0.0, -0.001, 0.0])}
    start = {"r": np.array([0.0, 0.0, 1.5]), "v": member["v"]}
    solution = tx.integrate(dynamics, start, t1=20.0, rtol=1e-8, params=params, event=landed)
    return solution, {"range": solution.xs["r"][-1, 0], "aside": solution.xs["r"][-1, 1], "time": solution.ts[-1]}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=2_000, help="throws (default: %(default)s)")
    parser.add_argument("--directory", help="where chunks are kept, to go on after a stop")
    parser.add_argument("--device", choices=("cpu", "gpu"), help="where throws are computed (default: JAX's choice)")
    arguments = parser.parse_args()
    try:
        devices = jax.local_devices(backend=arguments.device)
    except RuntimeError as error:
        parser.error(f"--device {arguments.device}: {error}")
    found = tx.sweep(run, throw, count=arguments.count, directory=arguments.directory, devices=devices)
    low, middle, high = (found.percentiles(p) for p in (5, 50, 95))
    print(f"{found}\n\n{'':8}{'mean':>9}{'std':>8}{'5 %':>9}{'50 %':>9}{'95 %':>9}")
    for name, unit in (("range", "m"), ("aside", "m"), ("time", "s")):
        numbers = (low[name], middle[name], high[name])
        shown = "".join(f"{number:9.2f}" for number in numbers)
        print(f"{name:8}{found.statistics.mean[name]:9.2f}{found.statistics.std[name]:8.2f}{shown} {unit}")

    landings = found.values
    figure, axes = plt.subplots(figsize=(6.0, 3.0), layout="constrained")
    axes.plot(landings["range"], landings["aside"], ".", markersize=2)
    axes.set(xlabel="range, m", ylabel="to the side, m", aspect="equal")
    figure.savefig("monte_carlo.png", dpi=100)


if __name__ == "__main__":
    main()
