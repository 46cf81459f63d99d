"""The cost of a filter step: generated C compared with a hand-written filter, and a batch compared with filterpy."""

import ctypes
import tempfile
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

import twistax as tx

from ...estimation import ErrorStateKalman, Trapezoidal
from ..harness.expected import at_most, needed
from ..harness.measurement import Section, slow
from ..harness.timing import Race, Timed, batch
from .steps import C_ARRAY, c_loop

SOURCE = Path(__file__).with_name("ins15.c")
_FLAGS = ("-O3", "-march=native")
_DENSITIES = np.array([2e-4, 2e-3, 1e-5, 1e-4])  # gyroscope, accelerometer, their drifts; SI units per sqrt(Hz)
_STEP, _GPS = 0.01, 1.5  # s, m
_READINGS = np.array([0.1, -0.05, 0.2]), np.array([0.3, 0.1, -9.7])
_MEASURED = np.array([0.4, -0.3, 0.2])


def ins() -> ErrorStateKalman:
    """The filter of `ins15.c`: attitude, velocity, position and the biases of both sensors."""
    R = tx.State("R", group=tx.SO3)
    v, p, bg, ba = (tx.State(name, shape=(3,)) for name in ("v", "p", "bg", "ba"))
    gyro, accelerometer = tx.Control("gyro", shape=(3,)), tx.Control("accelerometer", shape=(3,))
    noise = tx.Noise("noise", shape=(12,), density=np.repeat(_DENSITIES, 3))
    force = accelerometer - ba - noise[3:6]
    rates: dict[Any, Any] = {
        R: gyro - bg - noise[:3],
        v: R @ force + np.array([0.0, 0.0, 9.81]),
        p: v,
        bg: noise[6:9],
        ba: noise[9:],
    }
    gps = tx.Measurement("gps", p, covariance=_GPS**2)
    method = tx.RKMK(tx.tableaus.EULER)
    return ErrorStateKalman(tx.compile(tx.System(rates=rates)), [gps], method=method, noise=Trapezoidal())


#: Steps of generated code, as `by_hand` of `ins15.c` takes them.
_LOOP = """
#include <string.h>
#include "{source}"
void generated(double *x, double *P, const double *gyro, const double *acc, const double *d, double h, const double *z,
               double r, long steps) {{
    double y[21], Q[225], nis;
    (void)d; (void)r;
    for (long k = 0; k < steps; k++) {{
        kalman_predict(0.0, x, x + 9, x + 12, x + 15, x + 18, gyro, acc, P, h, y, y + 9, y + 12, y + 15, y + 18, Q);
        kalman_update_gps(0.0, y, y + 9, y + 12, y + 15, y + 18, gyro, acc, Q, z, x, x + 9, x + 12, x + 15, x + 18, P,
                          &nis);
    }}
}}
"""


def in_c(steps: int = 20_000) -> dict[str, Timed]:
    """Steps of the filter by `to_c` and by hand, on one core. Raises Absent without gcc."""
    with tempfile.TemporaryDirectory() as folder:
        files = ins().to_c(folder)
        loop = Path(folder) / "loop.c"
        loop.write_text(_LOOP.format(source=files.source))
        arguments = [C_ARRAY] * 5 + [ctypes.c_double, C_ARRAY, ctypes.c_double, ctypes.c_long]
        loops = {
            "to_c": c_loop(loop, "generated", arguments, *_FLAGS),
            "by hand": c_loop(SOURCE, "by_hand", arguments, *_FLAGS),
        }

    def timed(function: Any) -> Timed:
        def call() -> Any:
            x = np.concatenate([np.eye(3).ravel(), [1.0, 0.2, 0.0], np.zeros(9)])
            P = np.diag(np.repeat(np.array([0.02, 0.3, 1.5, 1e-3, 2e-2]) ** 2, 3)).ravel()
            function(x, P, *_READINGS, _DENSITIES**2, _STEP, _MEASURED, _GPS**2, steps)
            return np.concatenate([x, np.tril(P.reshape(15, 15)).ravel()])

        return Timed(call, steps)

    return {name: timed(function) for name, function in loops.items()}


def in_batches(count: int = 1000, alone: int = 100) -> dict[str, Timed]:
    """A prediction and an update of many filters at once, and of one by filterpy. Raises Absent without it."""
    peer = needed("filterpy.kalman").KalmanFilter(6, 3)
    p, v = tx.State("p", shape=(3,)), tx.State("v", shape=(3,))
    cart = tx.compile(tx.System(rates={p: v, v: tx.Noise("push", shape=(3,), density=0.3)}))
    gps = tx.Measurement("gps", p, covariance=_GPS**2)
    kalman = ErrorStateKalman(cart, [gps], method=tx.RKMK(tx.tableaus.EULER), noise=Trapezoidal())

    def step(x: Any, P: Any, z: Any) -> Any:
        prior = kalman.predict(0.0, x, P, 0.1)
        post = kalman.update("gps", 0.1, prior.x, prior.P, z)
        return post.x, post.P

    z = np.array([0.3, -0.1, 0.2])
    x, P = {"p": jnp.zeros((count, 3)), "v": jnp.zeros((count, 3))}, jnp.tile(jnp.eye(6), (count, 1, 1))
    measured = jnp.tile(jnp.asarray(z), (count, 1))
    peer.F, peer.H, peer.R = np.eye(6) + 0.1 * np.eye(6, k=3), np.eye(3, 6), _GPS**2 * np.eye(3)
    W = np.diag([0.0, 0.0, 0.0, 0.09, 0.09, 0.09])
    peer.Q = 0.05 * (peer.F @ W @ peer.F.T + W)

    def theirs() -> Any:
        for _ in range(alone):
            peer.x, peer.P = np.zeros((6, 1)), np.eye(6)
            peer.predict()
            peer.update(z[:, None])
        return np.concatenate([peer.x.ravel(), peer.P.ravel()])

    return {"batch": batch(step, x, P, measured), "filterpy": Timed(theirs, alone)}


def _first(result: Any) -> Any:
    """The state and covariance of the first filter."""
    if isinstance(result, tuple):
        x, P = result
        return np.concatenate([x["p"][0], x["v"][0], np.ravel(P[0])])
    return result


IN_C = Race(in_c, 1e-9)
IN_BATCHES = Race(in_batches, 1e-12, read=_first)
FILTERS: Section = [
    slow("a prediction and an update, 15 states", "to_c, gcc -O3", at_most(5.0, "us"), IN_C.seconds, "to_c", 1e-6),
    slow("its time over that of C by hand", "to_c, gcc -O3", at_most(1.3), IN_C.ratio, "to_c", "by hand"),
    slow(
        "a step of 1,000 filters, per filter, over one of filterpy",
        "jax.vmap, 6 states",
        at_most(0.01),
        IN_BATCHES.ratio,
        "batch",
        "filterpy",
    ),
]
