"""How many of eight perturbed guesses lead to a landing, and how good each is.

`python -m twistax.report.landing_guesses` prints the table. The guesses are those of `python -m twistax demo
--guess-seed N`, whose help says how they are perturbed.
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Iterator, Sequence

import jax

import twistax as tx
from twistax.scenes import powered_descent as scene
from twistax.scenes.touchdown import ALLOWED, Miss, flown, reaches

__all__ = ["NEEDED", "SEEDS", "Row", "main", "measure"]

SEEDS = range(1, 9)
"""The seeds tried."""

NEEDED = 7
"""How many of them have to land."""


@dataclasses.dataclass(frozen=True)
class Row:
    """What one guess led to.

    Attributes:
        seed: of the perturbation.
        landed: solved, flown again within the misses allowed, and within every limit between the nodes.
        mass: at the end, kg.
        flight_time: s.
        miss: of the controls flown again with RKMK4.
        iterations, seconds: of the search, compiling aside.
    """

    seed: int
    landed: bool
    mass: float
    flight_time: float
    miss: Miss
    iterations: int
    seconds: float


def measure(seeds: Sequence[int] = SEEDS, nodes: int = 25) -> Iterator[Row]:
    """One row for each seed; the search is compiled once."""
    problem = scene.problem(tx.compile(scene.system()), nodes=nodes)
    for seed in seeds:
        result = problem.solve(seed=seed)
        flight = flown(result, tx.RKMK(tx.tableaus.RK4))
        miss = Miss.of(flight)
        landed = result.solved and miss.within(ALLOWED) and all(r.holds for r in reaches(flight, scene.limits()))
        yield Row(seed, landed, result.cost, result.final_time, miss, result.iterations, result.solve_seconds)


def main() -> int:
    """Print the table; exit status 1 if fewer land than needed."""
    jax.config.update("jax_enable_x64", True)
    print(
        f"{'seed':>4} {'landed':>7} {'mass':>11} {'time':>8} {'miss':>10} {'':>12} {'iterations':>11} {'solved in':>10}"
    )
    rows = []
    for row in measure():
        rows.append(row)
        print(
            f"{row.seed:>4} {'yes' if row.landed else 'NO':>7} {row.mass:>8,.0f} kg {row.flight_time:>6.2f} s "
            f"{row.miss.position:>8.3f} m {row.miss.velocity:>8.4f} m/s {row.iterations:>11} {row.seconds:>8.1f} s",
            flush=True,
        )
    landed = sum(row.landed for row in rows)
    print(f"{landed} of {len(rows)} guesses land; {NEEDED} are needed")
    return 0 if landed >= NEEDED else 1


if __name__ == "__main__":
    sys.exit(main())
