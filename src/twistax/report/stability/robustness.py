"""Failed integrations in batches, derivatives and processes; rates with round-off noise; drift in single precision."""

import functools
import subprocess
import sys
from typing import Any

import jax
import numpy as np

import twistax as tx

from ..harness.expected import at_most
from ..harness.measurement import MeasuredCase, Section, quick

_METHODS: dict[str, Any] = {
    "RK4": tx.RKMK(tx.tableaus.RK4),
    "DOP853": tx.RKMK(tx.tableaus.DOP853),
    "CF4": tx.CommutatorFree(),
    "Magnus 4": tx.Magnus(),
    "Radau IIA 5": tx.ImplicitRKMK(tx.tableaus.RADAU_IIA5),
}


@functools.cache
def _ending() -> tx.Dynamics:
    """x' = sqrt(k - t) - x, which is not finite from t = k on."""
    x, k, t = tx.State("x"), tx.Parameter("k", value=0.5), tx.Time()
    return tx.compile(tx.System(rates={x: tx.Sqrt(k - t) - x}))


def _numbers_among_slopes(by: str, **how: Any) -> float:
    """How many derivatives of a failed integration are finite: forward and reverse mode, by start and parameter.

    NaN where derivatives of the other member of the batch, which does not fail, are not finite.
    """

    def end(x: Any, k: Any) -> Any:
        options = {"t1": 1.0, "params": {"k": k}, "method": _METHODS[by], "throw": False}
        return tx.integrate(_ending(), {"x": x}, **options, **how).xs["x"][-1]

    def slopes(x: Any, k: Any) -> Any:
        return jax.jacfwd(end, (0, 1))(x, k), jax.grad(end, (0, 1))(x, k)

    derivatives = jax.jit(jax.vmap(slopes))(np.array([0.7, 0.7]), np.array([0.5, 3.0]))
    failed, fine = np.array(jax.tree.leaves(derivatives)).T
    return float(np.isfinite(failed).sum()) if np.isfinite(fine).all() else float("nan")


_DYING = """
import jax; jax.config.update("jax_enable_x64", {x64})
import twistax as tx
x, v = tx.State("x"), tx.State("v")
system = tx.compile(tx.System(rates={{x: x * x, v: tx.Sqrt(0.5 - x)}}))
method = tx.ImplicitRKMK(tx.tableaus.RADAU_IIA5)
for start in ({{"x": 0.1, "v": 0.0}}, {{"x": 1.0, "v": 0.0}}):
    for how in ({{"steps": 9}}, {{"rtol": 1e-4, "save_at": [0.1, 2.0]}}):
        try:
            tx.integrate(system, start, t1=20.0, method=method, **how)
        except tx.IntegrationError:
            print("failed")
"""


def _died(x64: bool) -> float:
    """1 if a process dies of failing integrations, 0 if it ends well; NaN if no integration fails."""
    command = [sys.executable, "-c", _DYING.format(x64=x64)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        return 1.0
    return 0.0 if "failed" in done.stdout else float("nan")


def _noisy(**how: Any) -> float:
    """How far x is from cos t after 1 s of x' = 9e5 (cos t - x), with terms of 1e5 that cancel in its rate."""
    x, t = tx.State("x"), tx.Time()
    many = 1e5 * (1.0 + tx.Sin(7.0 * t))
    noisy = (tx.Cos(t) + many * (1.0 + x)) - (x + many + many * x)
    system = tx.compile(tx.System(rates={x: 9e5 * noisy}))
    sol = tx.integrate(system, {"x": 1.0}, t1=1.0, method=_METHODS["Radau IIA 5"], **how)
    return abs(float(sol.xs["x"][-1]) - np.cos(1.0))


@functools.cache
def _drifted(by: str) -> tuple[float, float, float]:
    """After a million steps in float32: errors of a clock, a position and a rotation, relative to how far they went."""
    y, g, rate = tx.State("y"), tx.State("g", group=tx.SE3), np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.01])
    system = tx.compile(tx.System(rates={y: 1.0 + 0.0 * y, g: rate}))
    start = {"y": np.float32(0.0), "g": np.eye(4, dtype=np.float32)}
    sol = tx.integrate(system, start, t1=1e4, steps=1_000_000, method=_METHODS[by])
    pose, clock = np.asarray(sol.xs["g"][-1], float), float(sol.xs["y"][-1])
    exact = np.array([np.sin(100.0), 1.0 - np.cos(100.0), 0.0]) / 0.01
    angle = np.arctan2(pose[1, 0], pose[0, 0]) - 100.0
    turned = abs((angle + np.pi) % (2.0 * np.pi) - np.pi)
    return abs(clock / 1e4 - 1.0), float(np.abs(pose[:3, 3] - exact).max()) / 1e4, turned / 100.0


_CLOCK, _PLACE, _ANGLE = range(3)


def _drift(by: str, which: int) -> float:
    return _drifted(by)[which]


def _slopes(by: str, steps_taken: str, **how: Any) -> MeasuredCase:
    what = f"derivatives that are numbers, of a failed integration in a batch, {steps_taken}"
    return quick(what, by, at_most(0), _numbers_among_slopes, by, **how)


_NOISE, _TIMES = "rate 9e5/s, with noise of 1e5 units of round-off", np.linspace(0.0, 1.0, 41)

SPOILED: Section = [
    "The derivative of what failed is NaN, forward and in reverse; the other member of the batch keeps its own.",
    _slopes("RK4", "steps of 0.05 s", steps=20),
    _slopes("DOP853", "rtol 1e-5", rtol=1e-5),
    _slopes("CF4", "steps of 0.05 s", steps=20),
    _slopes("Magnus 4", "steps of 0.05 s", steps=20),
    _slopes("Radau IIA 5", "steps of 0.05 s", steps=20),
    "Errors are made from numbers, by NumPy: nothing is compiled after a failure, and no process ends.",
    quick("processes that died of four failing integrations, x64 on", "Radau IIA 5", at_most(0), _died, True),
    quick("processes that died of four failing integrations, x64 off", "Radau IIA 5", at_most(0), _died, False),
    "Rounding of terms that cancel in a rate is no reason to give a step up.",
    quick(f"{_NOISE}, steps of 0.002 s", "Radau IIA 5", at_most(2e-6), _noisy, dt=2e-3),
    quick(f"{_NOISE}, rtol 1e-9, 41 saved times", "Radau IIA 5", at_most(2e-6), _noisy, rtol=1e-9, save_at=_TIMES),
    "What rounding takes off a state in single precision is carried along and added again.",
    *(
        quick(f"{what} after 1e6 steps of float32, of its way", by, at_most(1e-6), _drift, by, which)
        for by in ("RK4", "CF4")
        for which, what in ((_CLOCK, "a clock"), (_PLACE, "a position"), (_ANGLE, "a rotation"))
    ),
]
