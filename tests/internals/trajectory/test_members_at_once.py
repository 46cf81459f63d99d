"""Members of a batch of optima run at once."""

import os
from pathlib import Path

import jax
import pytest
from test_solution_in_programs import of_cart, points

from twistax.solver.processors import processors


def processor_times() -> dict[str, float]:
    """Seconds that each thread of this process has computed."""
    times = {}
    for stat in Path("/proc/self/task").glob("*/stat"):
        fields = stat.read_text().rpartition(")")[2].split()
        times[stat.parent.name] = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return times


@pytest.mark.skipif(not Path("/proc/self/task").exists() or processors() < 2, reason="no times of two threads here")
def test_members_run_at_once() -> None:
    """Two threads have a good share of a batch each."""
    every = points(4000)
    run = jax.jit(jax.vmap(lambda z: of_cart(z).cost))
    jax.block_until_ready(run(every))
    before = processor_times()
    jax.block_until_ready(run(every))  # one call: others may be run by other threads of the pool
    used = sorted(own - before.get(thread, 0.0) for thread, own in processor_times().items())
    assert used[-2] > 0.25 * sum(used)
