"""The true ends of the stiff scenes, found again in extended precision.

    python -m twistax.scenes.stiff_references [SCENE ...]

prints them, and how far two step sizes are apart. As in `references` nothing here uses the package's expressions or
integrators: the equations are written out in NumPy, and flown by `collocation`.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from . import actuator_lag, stiff_attitude, stiff_joint
from .arrays import Array, about, cross_matrix
from .collocation import collocated
from .references import Flat, cross, moved, printed
from .scene import Scene

__all__ = ["STIFF", "Stiff", "flown", "main"]

Values = Mapping[str, Any]


@dataclasses.dataclass(frozen=True)
class Stiff:
    """How a stiff scene is flown.

    Attributes:
        scenes: by name, with the numbers for which the end is stored.
        rates: rates of the states as plain numbers, from (t, states, parameters).
        steps: that suffice.
        fastest: rate of the fastest transient, 1/s, from the parameters.
    """

    scenes: tuple[Scene, ...]
    rates: Callable[[Any, Values, Values], dict[str, Array]]
    steps: int
    fastest: Callable[[Values], float]


def _stiff_attitude(t: Any, y: Values, params: Values) -> dict[str, Array]:
    R, w, k, J = y["R"], y["w"], params["k"], np.array(stiff_attitude.INERTIA)
    axis = np.array(stiff_attitude.AXIS, w.dtype)
    between = about(axis, stiff_attitude.SWING * np.sin(t)).T @ R
    skew = (between - between.T) / 2
    e = np.array([skew[2, 1], skew[0, 2], skew[1, 0]])
    return {"R": R @ cross_matrix(w), "w": (cross(J * w, w) - k * (e + w)) / J}


def _actuator_lag(t: Any, y: Values, params: Values) -> dict[str, Array]:
    v, w, F, a = y["V"][:3], y["V"][3:], y["F"], y["a"]
    m, J, n = actuator_lag.MASS, np.array(actuator_lag.INERTIA), y["g"][2, :3]
    side = F * a
    force = np.array([side[0], side[1], F]) - 9.81 * m * n - m * cross(w, v)
    torque = actuator_lag.ARM * np.array([side[1], -side[0], 0 * F]) - cross(w, J * w)
    command = 9.81 * m * (1 + 0.1 * np.cos(0.7 * t)) - 2 * v[2]
    gimbals = [-0.3 * n[0] + 0.15 * w[1] + 0.02 * np.sin(t), -0.3 * n[1] - 0.15 * w[0] + 0.02 * np.cos(2 * t)]
    return {
        "g": moved(y["g"], y["V"]),
        "V": np.concatenate([force / m, torque / J]),
        "F": (command - F) / params["tau"],
        "a": (np.array(gimbals) - a) / params["tau"],
    }


def _stiff_joint(t: Any, y: Values, params: Values) -> dict[str, Array]:
    places, speeds = [], []
    for g, V, point in zip((y["g1"], y["g2"]), (y["V1"], y["V2"]), stiff_joint.POINTS):
        places.append(g[:3, 3] + g[:3, :3] @ point)
        speeds.append(g[:3, :3] @ (V[:3] + cross(V[3:], point)))
    pull = params["k"] * (places[1] - places[0]) + params["c"] * (speeds[1] - speeds[0])
    found = {}
    for i, force in enumerate((pull, -pull)):
        g, V, m, J = y[f"g{i + 1}"], y[f"V{i + 1}"], stiff_joint.MASSES[i], np.array(stiff_joint.MOMENTS[i])
        torque = g[:3, :3].T @ cross((places[0] + places[1]) / 2 - g[:3, 3], force)
        linear = g[:3, :3].T @ force / m - cross(V[3:], V[:3])
        found[f"g{i + 1}"] = moved(g, V)
        found[f"V{i + 1}"] = np.concatenate([linear, (torque - cross(V[3:], J * V[3:])) / J])
    return found


#: By the name of the scene.
STIFF: dict[str, Stiff] = {
    "stiff-attitude": Stiff(
        tuple(map(stiff_attitude.scene, stiff_attitude.RATES)), _stiff_attitude, 100, lambda params: params["k"]
    ),
    "actuator-lag": Stiff(
        tuple(map(actuator_lag.scene, actuator_lag.LAGS)), _actuator_lag, 100, lambda params: 1 / params["tau"]
    ),
    "stiff-joint": Stiff((stiff_joint.STIFF_JOINT,), _stiff_joint, 200, lambda params: 2e5),
}


def flown(scene: Scene, steps: int) -> dict[str, Array]:
    """The end of a stiff scene, in extended precision."""
    how, flat = STIFF[scene.name], Flat.like(scene.start)
    start = flat.pack(scene.start).astype(np.longdouble)

    def rate(t: Any, y: Array) -> Array:
        return flat.pack(how.rates(t, flat.unpack(y), scene.params))

    end = collocated(rate, start, scene.duration, steps, float(how.fastest(scene.params)))
    return flat.unpack(end)


def main(arguments: list[str] | None = None) -> int:
    """Prints the ends as Python."""
    parser = argparse.ArgumentParser(
        prog="python -m twistax.scenes.stiff_references", description=__doc__.split("\n")[0]
    )
    parser.add_argument("scenes", nargs="*", metavar="SCENE", help=f"of {', '.join(STIFF)}; all if left out")
    names = parser.parse_args(arguments).scenes or list(STIFF)
    for name in names:
        if name not in STIFF:
            parser.error(f"no scene {name!r} here; there are {', '.join(STIFF)}")
    for name in names:
        for scene in STIFF[name].scenes:
            steps = STIFF[name].steps
            printed(scene, steps, flown(scene, steps), flown(scene, 3 * steps // 2))
    return 0


if __name__ == "__main__":
    sys.exit(main())
