"""The true ends of the scenes without a closed form, found again in extended precision.

    python -m twistax.scenes.references [SCENE ...]

prints them, and how far two step sizes are apart. Nothing here uses the package's expressions or integrators: the
equations are written out in NumPy, and flown by extrapolation of the modified midpoint rule (Gragg, Bulirsch, Stoer;
Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, section II.9) in the longest float NumPy has. On x86
that is 64 bits of mantissa, 1e-19; elsewhere it may be a double, and the last digits differ.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from . import heavy_top, low_orbit, rocket, spinning_satellite, spring_bodies, tumbling_brick
from .arrays import Array, cross_matrix
from .scene import Scene

__all__ = ["RATES", "STEPS", "Flat", "cross", "extrapolated", "flown", "main", "moved", "printed"]

Values = Mapping[str, Array]
Rates = Callable[[Any, Values], dict[str, Array]]

#: Midpoint steps inside of a step; the error of the extrapolation is of order twice their number.
_PARTS = (2, 4, 6, 8, 10, 12, 14, 16)


# ---- the equations: matrices and vectors as plain numbers -----------------------------------------------------------


def cross(a: Array, b: Array) -> Array:
    """The cross product (3,) in the precision of its factors."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def moved(g: Array, V: Array) -> Array:
    """The rate (4, 4) of a pose with body twist V: R' = R [w]x, p' = R v."""
    rate = np.zeros_like(g)
    rate[:3, :3], rate[:3, 3] = g[:3, :3] @ cross_matrix(V[3:]), g[:3, :3] @ V[:3]
    return rate


def _heavy_top(t: Any, y: Values) -> dict[str, Array]:
    J, R, w = np.array(heavy_top.INERTIA), y["R"], y["w"]
    # The weight acts at a lever arm along the axis: MOMENT e_z x (-R' e_z).
    lever = np.array([0.0, 0.0, heavy_top.MOMENT])
    return {"R": R @ cross_matrix(w), "w": (cross(lever, -R[2]) - cross(w, J * w)) / J}


def _rocket(t: Any, y: Values) -> dict[str, Array]:
    R, v, w, m = y["g"][:3, :3], y["V"][:3], y["V"][3:], y["m"]
    k = np.array(rocket.RADII_SQUARED)
    F, gimbal = 30 * (1 - 0.02 * t), 0.02 * np.sin(1.3 * t)
    side, lift = F * gimbal, 0.5 * F * gimbal * np.cos(t)
    drag = 0.01 * np.sqrt(v @ v + 1e-12)
    force = np.array([F, side, lift]) - drag * v - 9.81 * m * R[2]
    roll = 0.05 - 0.05 * w[0]
    pitch = 0.5 * lift - 0.3 * w[1] + 0.02 * v[2]
    yaw = -0.5 * side - 0.3 * w[2] - 0.02 * v[1]
    torque = np.array([roll, pitch, yaw]) - cross(w, m * k * w) - rocket.MASS_FLOW * k * w
    return {
        "g": moved(y["g"], y["V"]),
        "V": np.concatenate([force / m - cross(w, v), torque / (m * k)]),
        "m": np.asarray(rocket.MASS_FLOW),
    }


def _gravity(p: Array, gm: float, radius: float, j2: float) -> Array:
    """Gravity (3,) of a point mass and the second zonal harmonic."""
    r = np.sqrt(p @ p)
    z = p[2] / r
    pull = np.array([1 - 5 * z**2, 1 - 5 * z**2, 3 - 5 * z**2])
    return -gm / r**3 * (p + 1.5 * j2 * (radius / r) ** 2 * pull * p)


def _orbit(inertia: Sequence[float], t: Any, y: Values) -> dict[str, Array]:
    J, earth, w, p = np.array(inertia), low_orbit.EARTH, y["w"], y["p"]
    r = np.sqrt(p @ p)
    down = -(y["R"].T @ p) / r
    torque = 3 * earth.gm / r**3 * cross(down, J * down)
    return {
        "R": y["R"] @ cross_matrix(w),
        "w": (torque - cross(w, J * w)) / J,
        "p": y["v"],
        "v": _gravity(p, earth.gm, earth.radius, earth.j2),
    }


def _spring_bodies(t: Any, y: Values) -> dict[str, Array]:
    count = len(y) // 2
    before, after = spring_bodies.POINTS
    found: dict[str, Array] = {}
    pulls = [np.zeros(6, y["V1"].dtype) for _ in range(count)]  # force in the world, torque in the body
    for i in range(count - 1):
        g, h = y[f"g{i + 1}"], y[f"g{i + 2}"]
        line = h[:3, 3] + h[:3, :3] @ before - g[:3, 3] - g[:3, :3] @ after
        d = np.sqrt(line @ line)
        force = spring_bodies.STIFFNESS * (d - spring_bodies.LENGTH) * line / d
        for pull, pose, arm, f in ((pulls[i], g, after, force), (pulls[i + 1], h, before, -force)):
            pull[:3] += f
            pull[3:] += cross(arm, pose[:3, :3].T @ f)
    for i, pull in enumerate(pulls):
        g, V = y[f"g{i + 1}"], y[f"V{i + 1}"]
        m, J = spring_bodies.MASSES[i % 3], np.array(spring_bodies.MOMENTS[i % 3])
        v, w = V[:3], V[3:]
        linear = g[:3, :3].T @ pull[:3] / m - cross(w, v)
        found[f"g{i + 1}"] = moved(g, V)
        found[f"V{i + 1}"] = np.concatenate([linear, (pull[3:] - cross(w, J * w)) / J])
    return found


def _tumbling_brick(t: Any, y: Values) -> dict[str, Array]:
    earth, J = tumbling_brick.EARTH, tumbling_brick.TUMBLING_BRICK.params["inertia"]
    g, v, w = y["g"], y["V"][:3], y["V"][3:]
    fall = g[:3, :3].T @ _gravity(g[:3, 3], earth.gm, earth.radius, earth.j2)
    return {"g": moved(g, y["V"]), "V": np.concatenate([fall - cross(w, v), -cross(w, J * w) / J])}


#: Rates of the states as plain numbers, by scene.
RATES: dict[str, Rates] = {
    "heavy-top": _heavy_top,
    "rocket": _rocket,
    "low-orbit": functools.partial(_orbit, low_orbit.INERTIA),
    "spinning-satellite": functools.partial(_orbit, spinning_satellite.INERTIA),
    "spring-bodies": _spring_bodies,
    "tumbling-brick": _tumbling_brick,
}
#: Steps that suffice, by scene.
STEPS = {
    "heavy-top": 300,
    "rocket": 100,
    "low-orbit": 100,
    "spinning-satellite": 24_000,
    "spring-bodies": 150,
    "tumbling-brick": 100,
}


# ---- flying them ----------------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Flat:
    """States by name as one vector, in the order and the shapes of an example."""

    shapes: dict[str, tuple[int, ...]]

    @staticmethod
    def like(y: Mapping[str, Any]) -> Flat:
        return Flat({name: np.shape(value) for name, value in y.items()})

    def pack(self, y: Mapping[str, Any]) -> Array:
        """One vector, in the precision of the values."""
        return np.concatenate([np.ravel(y[name]) for name in self.shapes])

    def unpack(self, vector: Array) -> dict[str, Array]:
        """The states by name."""
        ends = np.cumsum([int(np.prod(shape)) for shape in self.shapes.values()])
        parts = np.split(vector, ends[:-1])
        return {name: part.reshape(shape) for (name, shape), part in zip(self.shapes.items(), parts)}


def extrapolated(rate: Callable[[Any, Array], Array], y0: Array, duration: float, steps: int) -> Array:
    """y(duration) of y' = rate(t, y) by so many extrapolated steps of order 16, in the precision of y0."""
    y, h = y0, y0.dtype.type(duration) / steps
    for step in range(steps):
        y = _extrapolated_step(rate, step * h, y, h)
    return y


def _extrapolated_step(rate: Callable[[Any, Array], Array], t: Any, y: Array, h: Any) -> Array:
    """One step. What is extrapolated is the change of y, which rounds less than y itself."""
    slope = rate(t, y)
    row: list[Array] = []
    for k, parts in enumerate(_PARTS):
        part = h / parts
        last, now = np.zeros_like(y), part * slope
        for i in range(1, parts):
            last, now = now, last + 2 * part * rate(t + i * part, y + now)
        new = [now]
        for j in range(k):
            square = (y.dtype.type(parts) / _PARTS[k - 1 - j]) ** 2
            new.append(new[j] + (new[j] - row[j]) / (square - 1))
        row = new
    return y + row[-1]


def flown(scene: Scene, steps: int) -> dict[str, Array]:
    """The end of a scene in `RATES`, in extended precision."""
    flat = Flat.like(scene.start)
    start = flat.pack(scene.start).astype(np.longdouble)

    def rate(t: Any, y: Array) -> Array:
        return flat.pack(RATES[scene.name](t, flat.unpack(y)))

    return flat.unpack(extrapolated(rate, start, scene.duration, steps))


def printed(scene: Scene, steps: int, coarse: Values, fine: Values) -> None:
    """Prints the end of a scene as Python, and how far those of two step sizes are apart."""
    apart = max(float(np.max(np.abs(fine[s] - coarse[s]) / max(1.0, float(np.max(np.abs(fine[s])))))) for s in fine)
    values = ", ".join(f"{name} = {value:g}" for name, value in scene.params.items() if value.shape == ())
    which = f"{scene.name}, {values}" if values else scene.name
    print(f"# {which}: {steps} and {3 * steps // 2} steps are {apart:.1e} apart")
    for state, value in fine.items():
        print(f'    "{state}": np.array({value.astype(float).tolist()}),')


def main(arguments: list[str] | None = None) -> int:
    """Prints the ends as Python."""
    from . import SCENES

    parser = argparse.ArgumentParser(prog="python -m twistax.scenes.references", description=__doc__.split("\n")[0])
    parser.add_argument("scenes", nargs="*", metavar="SCENE", help=f"of {', '.join(RATES)}; all if left out")
    names = parser.parse_args(arguments).scenes or list(RATES)
    for name in names:
        if name not in RATES:
            parser.error(f"no scene {name!r} here; there are {', '.join(RATES)}")
    for name in names:
        printed(SCENES[name], STEPS[name], *(flown(SCENES[name], n * STEPS[name] // 2) for n in (2, 3)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
