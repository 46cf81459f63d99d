"""Small matrices in JAX on the CPU, without and with `tx.fast`: four programs that users reported as slow.

Each is a small version of a program in an issue of https://github.com/jax-ml/jax: 36799 (products of 3x3 matrices in
a scan, and many small solves), 40150 (the gradient of a scan that carries sixty scalars), 26145 (a neuron with Hodgkin
and Huxley's equations, its gradient and a batch) and 26021 (the mass matrix of a chain, here of 20 joints). Results are
compared before times. JAX 0.11 and later run loops over scalars faster, so ratios depend on the version.

    python examples/small_matrices.py            # everything, half a minute
    python examples/small_matrices.py --issue 26145 --repeat 3
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import twistax as tx

# ---- issue 36799 -----------------------------------------------------------------------------------------------------


def products(matrix: jax.Array) -> jax.Array:
    """A 3x3 matrix times itself, 10,000 times."""
    return jax.lax.scan(lambda c, _: (matrix @ c, None), jnp.eye(3, dtype=matrix.dtype), None, length=10_000)[0]


# ---- issue 40150 -----------------------------------------------------------------------------------------------------

LEAVES = 60


def network(x: jax.Array) -> jax.Array:
    """A state of sixty named scalars, each driven by its neighbour, 614 steps."""
    names = [f"s{k}" for k in range(LEAVES)]

    def step(state: dict[str, jax.Array], u: jax.Array) -> tuple[dict[str, jax.Array], jax.Array]:
        pairs = zip(names, names[1:] + names[:1], strict=True)
        new = {a: 0.9 * state[a] + 0.1 * jnp.tanh(state[b] * state[a]) + 0.01 * u for a, b in pairs}
        return new, new["s0"]

    start = {name: x * (k + 1) / LEAVES for k, name in enumerate(names)}
    return jax.lax.scan(step, start, jnp.linspace(0.0, 1.0, 614))[1].sum()


# ---- issue 26145 -----------------------------------------------------------------------------------------------------


def neuron(conductances: jax.Array, current: jax.Array) -> jax.Array:
    """Membrane potential of Hodgkin and Huxley's neuron (1952): 4,000 steps of 25 us, exponential Euler; mV, ms, uA."""
    dt = 0.025

    def gate(x: jax.Array, opening: jax.Array, closing: jax.Array) -> jax.Array:
        rate = opening + closing
        kept = jnp.exp(-dt * rate)
        return x * kept + opening / rate * (1.0 - kept)

    def step(state: tuple[jax.Array, ...], _: None) -> tuple[tuple[jax.Array, ...], jax.Array]:
        v, m, h, n = state
        m = gate(m, 0.1 * (v + 40.0) / (1.0 - jnp.exp(-(v + 40.0) / 10.0)), 4.0 * jnp.exp(-(v + 65.0) / 18.0))
        h = gate(h, 0.07 * jnp.exp(-(v + 65.0) / 20.0), 1.0 / (1.0 + jnp.exp(-(v + 35.0) / 10.0)))
        n = gate(n, 0.01 * (v + 55.0) / (1.0 - jnp.exp(-(v + 55.0) / 10.0)), 0.125 * jnp.exp(-(v + 65.0) / 80.0))
        sodium, potassium, leak = conductances
        outward = sodium * m**3 * h * (v - 50.0) + potassium * n**4 * (v + 77.0) + leak * (v + 54.4)
        v = v - dt * (outward - current)
        return (v, m, h, n), v

    rest = tuple(jnp.asarray(value, conductances.dtype) for value in (-65.0, 0.05, 0.6, 0.32))
    return jax.lax.scan(step, rest, None, length=4_000)[1]


def mean_square(run: Callable[..., jax.Array]) -> Callable[..., jax.Array]:
    """The gradient of the mean square of a potential by the conductances."""
    return jax.grad(lambda conductances, current: (run(conductances, current) ** 2).mean())


# ---- issue 26021 -----------------------------------------------------------------------------------------------------

JOINTS = 20


def mass_matrix(angles: jax.Array) -> jax.Array:
    """Of a chain of unit masses whose joints turn about z and x in turn: the sum of J^T J over the bodies."""
    pose, axes, origins, centres = jnp.eye(4, dtype=angles.dtype), [], [], []
    for k in range(JOINTS):
        c, s = jnp.cos(angles[k]), jnp.sin(angles[k])
        about_z = jnp.array([[c, -s, 0.0, 0.0], [s, c, 0.0, 0.0], [0.0, 0.0, 1.0, 0.1], [0.0, 0.0, 0.0, 1.0]])
        about_x = jnp.array([[1.0, 0.0, 0.0, 0.0], [0.0, c, -s, 0.0], [0.0, s, c, 0.1], [0.0, 0.0, 0.0, 1.0]])
        axes.append(pose[:3, 2 if k % 2 == 0 else 0])
        origins.append(pose[:3, 3])
        pose = pose @ (about_z if k % 2 == 0 else about_x)
        centres.append(pose[:3, 3])
    total = jnp.zeros((JOINTS, JOINTS), angles.dtype)
    for k, centre in enumerate(centres):
        arms = jnp.stack([jnp.cross(axes[j], centre - origins[j]) for j in range(k + 1)])
        total = total.at[: k + 1, : k + 1].add(arms @ arms.T)
    return total


# ---- both ways -------------------------------------------------------------------------------------------------------

Case = tuple[str, Callable[..., Any], Callable[..., Any], tuple[Any, ...]]


def cases() -> Iterator[Case]:
    """A name, the function by `jax.jit` and by `tx.fast`, and the arguments."""
    random = np.random.default_rng(0)
    matrix = jnp.asarray(0.99 * np.eye(3) + 0.01)
    many, sides = jnp.asarray(random.normal(size=(10_000, 3, 3))), jnp.ones((10_000, 3))
    conductances, current = jnp.array([120.0, 36.0, 0.3]), jnp.asarray(10.0)
    currents = jnp.linspace(5.0, 15.0, 256)
    x, angles = jnp.asarray(0.5), jnp.asarray(random.normal(size=JOINTS))
    solve, batch = jnp.linalg.solve, (None, 0)
    yield "36799: 10,000 products of 3x3", jax.jit(products), tx.fast(products), (matrix,)
    yield "36799: 10,000 solves of 3x3", jax.jit(jax.vmap(solve)), jax.jit(jax.vmap(tx.fast(solve))), (many, sides)
    yield "40150: sixty scalars", jax.jit(network), tx.fast(network), (x,)
    yield "40150: their gradient", jax.jit(jax.grad(network)), tx.fast(jax.grad(network)), (x,)
    yield "26145: neuron", jax.jit(neuron), tx.fast(neuron), (conductances, current)
    slopes = mean_square(neuron)
    yield "26145: its gradient", jax.jit(slopes), tx.fast(slopes), (conductances, current)
    batches = jax.jit(jax.vmap(neuron, batch)), jax.jit(jax.vmap(tx.fast(neuron), batch))
    yield "26145: 256 neurons", *batches, (conductances, currents)
    # Of more than 128 entries an array counts as one that the processor's vectors suit as well; this one has 400.
    wide = tx.fast(mass_matrix, backend=tx.Native(tx.XLA(widest=400)))
    yield "26021: mass matrix of 20 joints", jax.jit(mass_matrix), wide, (angles,)


def median(function: Callable[..., Any], arguments: tuple[Any, ...], repeat: int) -> float:
    """Of a call, microseconds."""
    times = []
    for _ in range(repeat):
        start = time.perf_counter()
        jax.block_until_ready(function(*arguments))
        times.append(time.perf_counter() - start)
    return float(np.median(times)) * 1e6


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeat", type=int, default=21, help="calls that are timed (default: %(default)s)")
    parser.add_argument("--issue", default="", help="the number of one of them (default: all)")
    repeat, issue = (given := parser.parse_args()).repeat, given.issue
    jax.config.update("jax_enable_x64", True)
    print(f"JAX {jax.__version__}, float64, medians of {repeat} calls in us\n")
    print(f"{'':34}{'jax.jit':>10}{'tx.fast':>10}{'ratio':>8}{'differ by':>12}")
    for name, plain, fast, arguments in (case for case in cases() if case[0].startswith(issue)):
        expected, found = plain(*arguments), fast(*arguments)
        apart = float(jnp.abs(expected - found).max() / jnp.abs(expected).max())
        before, after = median(plain, arguments, repeat), median(fast, arguments, repeat)
        print(f"{name:34}{before:10.1f}{after:10.1f}{after / before:8.3f}{apart:12.1e}", flush=True)


if __name__ == "__main__":
    main()
