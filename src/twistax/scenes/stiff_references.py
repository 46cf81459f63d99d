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

from . import stiff_attitude
from .arrays import Array, about, cross_matrix
from .collocation import collocated
from .references import Flat, cross, printed
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


#: By the name of the scene.
STIFF: dict[str, Stiff] = {
    "stiff-attitude": Stiff(
        tuple(map(stiff_attitude.scene, stiff_attitude.RATES)), _stiff_attitude, 100, lambda params: params["k"]
    ),
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
