"""What lowering costs before anything runs: equations of a shared chain, and the time of `import twistax`.

`python -m twistax.report.lowering_cost` prints both. Exit status 1 if a figure is above its bar.
"""

from __future__ import annotations

import subprocess
import sys
from statistics import median

import jax
import jax.numpy as jnp

from ..expr import Expr, Sin, State
from ..lowering import compile, lower
from ..lowering.explain import count_equations
from ..system import System
from .machine import machine

__all__ = ["EQUATIONS_BAR", "IMPORT_BAR", "chain_equations", "import_seconds", "main"]

EQUATIONS_BAR = 30
"""Equations of a chain of 24 nodes in which every node uses the one before twice."""

IMPORT_BAR = 0.3
"""Seconds of `import twistax` beyond `import jax`."""

_NODES = 24
_RUNS = 7


def shared_chain() -> tuple[State, Expr]:
    """x, and a chain of 24 nodes over it, each of which uses the one before twice or folds it by a sine."""
    x = State("x", shape=(3,))
    node: Expr = x
    for i in range(_NODES):
        node = Sin(node) if i % 3 == 2 else node + node if i % 3 else node * node
    return x, node


def chain_equations() -> dict[str, int]:
    """Equations of the chain, as a lone expression and as the rate of a compiled system."""
    x, chain = shared_chain()
    value = {"x": jnp.ones(3)}
    dynamics = compile(System(rates={x: chain}))
    forms = {
        "lower": lambda v: lower(chain)(0.0, v),
        "compile": lambda v: dynamics._functions.vector_field(jnp.zeros(()), v, {}, {}),
    }
    return {name: count_equations(jax.make_jaxpr(form)(value).jaxpr) for name, form in forms.items()}


def import_seconds() -> float:
    """Median over fresh processes of the time `import twistax` takes once JAX is imported."""
    code = "import time, jax; t = time.perf_counter(); import twistax; print(time.perf_counter() - t)"
    runs = [
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True) for _ in range(_RUNS)
    ]
    return median(float(run.stdout) for run in runs)


def main() -> int:
    """Prints the figures; exit status 1 if a bar is missed."""
    print(machine())
    equations, seconds = chain_equations(), import_seconds()
    for name, count in equations.items():
        print(f"shared chain of {_NODES} nodes, {name}: {count} equations (bar {EQUATIONS_BAR})")
    print(f"import twistax beyond import jax, median of {_RUNS} fresh processes: {seconds:.2f} s (bar {IMPORT_BAR} s)")
    held = max(equations.values()) <= EQUATIONS_BAR and seconds < IMPORT_BAR
    print("all bars hold" if held else "A BAR IS MISSED")
    return 0 if held else 1


if __name__ == "__main__":
    raise SystemExit(main())
