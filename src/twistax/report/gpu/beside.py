"""Kernels of the CPU and the solver, in processes with and without a GPU, which take turns."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from ..sections import flights, problems
from . import cases

#: Processes of either kind; calls of each, after one that is not counted.
PROCESSES, TURNS = 3, 12
WITH, WITHOUT = "with a GPU", "without"
#: What a process runs; what it says when it is ready.
_SERVE, _READY = "from twistax.report.gpu.beside import serve; serve()", "ready"


def _functions() -> dict[str, tuple[Callable[[], Any], float, str]]:
    """By name, a call, a factor for its seconds, and the unit."""
    import twistax as tx

    bodies, joints = cases.bodies(4096, np.float64), cases.joints(4096, np.float64)
    rollout, arm = jax.jit(cases.rollout(tx.Native())), jax.jit(cases.accelerations(tx.Native()))
    cart, quadrotor = problems.cart_pole(), flights.quadrotor()
    return {
        "rollout on the CPU, 4,096": (lambda: rollout(bodies), 1e9 / 4096 / cases.STEPS, "ns a body and step"),
        "ABA on the CPU, 4,096": (lambda: [arm(*joints) for _ in range(20)], 1e9 / 4096 / 20, "ns a body"),
        "solve, cart-pole": (lambda: cart.solve().cost, 1e3, "ms"),
        "solve, quadrotor": (lambda: quadrotor.solve().cost, 1e3, "ms"),
    }


def serve() -> None:
    """Answer each line, the name of a function, with the seconds of a call."""
    jax.config.update("jax_enable_x64", True)
    platforms = {device.platform for device in jax.devices()}
    with jax.default_device(jax.local_devices(backend="cpu")[0]):
        functions = _functions()
        print(_READY, *platforms, flush=True)
        for line in sys.stdin:
            begin = time.perf_counter()
            jax.block_until_ready(functions[line.strip()][0]())
            print(time.perf_counter() - begin, flush=True)


class _Process:
    def __init__(self, platforms: str | None) -> None:
        environment = {**os.environ, **({"JAX_PLATFORMS": platforms} if platforms else {})}
        command = [sys.executable, "-u", "-c", _SERVE]
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(command, env=environment, stdin=pipe, stdout=pipe, text=True)

    def read(self) -> str:
        assert self._process.stdout is not None
        while not (line := self._process.stdout.readline()).startswith(_READY):
            if not line or line[0].isdigit():
                return line.strip()
        return line.strip()

    def call(self, name: str) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(f"{name}\n")
        self._process.stdin.flush()

    def close(self) -> None:
        self._process.kill()
        self._process.wait()


def measured() -> list[tuple[str, str, float, str]]:
    """What, in which processes, the median of the calls of a process, and its unit; then the ratios of the medians."""
    kinds = [WITH, WITHOUT] * PROCESSES
    processes = [_Process("cpu" if kind is WITHOUT else None) for kind in kinds]
    rows: list[tuple[str, str, float, str]] = []
    try:
        for process, kind in zip(processes, kinds, strict=True):
            ready = process.read()
            if not ready.startswith(_READY) or ("gpu" in ready) != (kind is WITH):
                raise RuntimeError(f"a process {kind} is not ready: {ready!r}")
        for name, (_, factor, unit) in _functions().items():
            for process in processes:  # compile, all at once
                process.call(name)
            for process in processes:
                process.read()
            times: list[list[float]] = [[] for _ in processes]
            for turn in range(TURNS):
                order = range(len(processes)) if turn % 2 else reversed(range(len(processes)))
                for k in order:
                    processes[k].call(name)
                    times[k].append(float(processes[k].read()) * factor)
            medians = [float(np.median(values)) for values in times]
            rows += [(name, kind, median, unit) for kind, median in zip(kinds, medians, strict=True)]
            ends = [float(np.median([m for m, k in zip(medians, kinds, strict=True) if k is kind])) for kind in kinds]
            rows.append((name, f"{WITH} over {WITHOUT}", ends[0] / ends[1], ""))
    finally:
        for process in processes:
            process.close()
    return rows
