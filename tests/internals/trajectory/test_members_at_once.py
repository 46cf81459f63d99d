"""Members of a batch of optima run at once."""

import functools
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from trajectory_systems import HEUN

import twistax as tx
from twistax.solver.processors import processors
from twistax.trajectory import Problem, Solution, solution


@functools.cache
def cart() -> Callable[..., Solution]:
    """A mass under drag, from a start to an end with limits on force and speed."""
    p, v, u = tx.State("p"), tx.State("v", max=0.9), tx.Control("u", min=-1.0, max=1.0)
    drag = tx.Parameter("drag", value=0.1)
    dynamics = tx.compile(tx.System(rates={p: v, v: u - drag * v * v}))
    return solution(
        Problem(
            dynamics,
            tx.Minimize(running=u**2 + 0.1 * p**2),
            nodes=11,
            final_time=3.0,
            initial={p: 0.0, v: 0.0},
            final={p: 1.0, v: 0.0},
            **HEUN,
        )
    )


def of_cart(z: Any) -> Solution:
    return cart()(params={"drag": z[0]}, initial={"p": z[1], "v": z[2]}, final={"p": z[3], "v": 0.0}, final_time=z[4])


POINT = np.array([0.2, 0.1, 0.05, 1.2, 2.5])


def points(count: int) -> np.ndarray:
    return POINT + 0.05 * np.random.default_rng(1).normal(size=(count, len(POINT)))


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
