"""The true ends of the scenes without a closed form, found again in extended precision.

    python -m twistax.scenes.references [SCENE ...]

prints them, and how far two step sizes are apart. Nothing here uses the package's expressions or integrators: the
equations are NumPy, solved by extrapolation of the modified midpoint rule (Gragg, Bulirsch, Stoer; Hairer, Norsett,
Wanner, Solving Ordinary Differential Equations I, section II.9), stiff ones by `collocation`, in NumPy's longest float.
On x86 that is 64 bits of mantissa, 1e-19; elsewhere it may be a double, and the last digits differ.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from . import (
    actuator_lag,
    heavy_top,
    low_orbit,
    rocket,
    spring_bodies,
    stiff_attitude,
    stiff_joint,
    tumbling_brick,
)
from .arrays import Array, about, cross_matrix
from .collocation import collocated
from .scene import Scene

__all__ = ["REFERENCES", "Reference", "extrapolated", "main"]

Values = Mapping[str, Array]

#: Midpoint steps inside of a step; the error of the extrapolation is of order twice their number.
_PARTS = (2, 4, 6, 8, 10, 12, 14, 16)


# ---- the equations: matrices and vectors as plain numbers -----------------------------------------------------------


def _cross(a: Array, b: Array) -> Array:
    """The cross product (3,) in the precision of its factors."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _moved(g: Array, V: Array) -> Array:
    """The rate (4, 4) of a pose with body twist V: R' = R [w]x, p' = R v."""
    rate = np.zeros_like(g)
    rate[:3, :3], rate[:3, 3] = g[:3, :3] @ cross_matrix(V[3:]), g[:3, :3] @ V[:3]
    return rate


def _heavy_top(t: Any, y: Values, params: Values) -> dict[str, Array]:
    J, R, w = np.array(heavy_top.INERTIA), y["R"], y["w"]
    # The weight acts at a lever arm along the axis: MOMENT e_z x (-R' e_z).
    lever = np.array([0.0, 0.0, heavy_top.MOMENT])
    return {"R": R @ cross_matrix(w), "w": (_cross(lever, -R[2]) - _cross(w, J * w)) / J}


def _rocket(t: Any, y: Values, params: Values) -> dict[str, Array]:
    R, v, w, m = y["g"][:3, :3], y["V"][:3], y["V"][3:], y["m"]
    k = np.array(rocket.RADII_SQUARED)
    F, gimbal = 30 * (1 - 0.02 * t), 0.02 * np.sin(1.3 * t)
    side, lift = F * gimbal, 0.5 * F * gimbal * np.cos(t)
    drag = 0.01 * np.sqrt(v @ v + 1e-12)
    force = np.array([F, side, lift]) - drag * v - 9.81 * m * R[2]
    roll = 0.05 - 0.05 * w[0]
    pitch = 0.5 * lift - 0.3 * w[1] + 0.02 * v[2]
    yaw = -0.5 * side - 0.3 * w[2] - 0.02 * v[1]
    torque = np.array([roll, pitch, yaw]) - _cross(w, m * k * w) - rocket.MASS_FLOW * k * w
    return {
        "g": _moved(y["g"], y["V"]),
        "V": np.concatenate([force / m - _cross(w, v), torque / (m * k)]),
        "m": np.asarray(rocket.MASS_FLOW),
    }


def _gravity(p: Array, gm: float, radius: float, j2: float) -> Array:
    """Gravity (3,) of a point mass and the second zonal harmonic."""
    r = np.sqrt(p @ p)
    z = p[2] / r
    pull = np.array([1 - 5 * z**2, 1 - 5 * z**2, 3 - 5 * z**2])
    return -gm / r**3 * (p + 1.5 * j2 * (radius / r) ** 2 * pull * p)


def _orbit(inertia: Sequence[float]) -> Callable[[Any, Values, Values], dict[str, Array]]:
    def rates(t: Any, y: Values, params: Values) -> dict[str, Array]:
        J, earth, w, p = np.array(inertia), low_orbit.EARTH, y["w"], y["p"]
        r = np.sqrt(p @ p)
        down = -(y["R"].T @ p) / r
        torque = 3 * earth.gm / r**3 * _cross(down, J * down)
        return {
            "R": y["R"] @ cross_matrix(w),
            "w": (torque - _cross(w, J * w)) / J,
            "p": y["v"],
            "v": _gravity(p, earth.gm, earth.radius, earth.j2),
        }

    return rates


def _spring_bodies(t: Any, y: Values, params: Values) -> dict[str, Array]:
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
            pull[3:] += _cross(arm, pose[:3, :3].T @ f)
    for i, pull in enumerate(pulls):
        g, V = y[f"g{i + 1}"], y[f"V{i + 1}"]
        m, J = spring_bodies.MASSES[i % 3], np.array(spring_bodies.MOMENTS[i % 3])
        v, w = V[:3], V[3:]
        linear = g[:3, :3].T @ pull[:3] / m - _cross(w, v)
        found[f"g{i + 1}"] = _moved(g, V)
        found[f"V{i + 1}"] = np.concatenate([linear, (pull[3:] - _cross(w, J * w)) / J])
    return found


def _tumbling_brick(t: Any, y: Values, params: Values) -> dict[str, Array]:
    earth, J = tumbling_brick.EARTH, params["inertia"]
    g, v, w = y["g"], y["V"][:3], y["V"][3:]
    fall = g[:3, :3].T @ _gravity(g[:3, 3], earth.gm, earth.radius, earth.j2)
    return {"g": _moved(g, y["V"]), "V": np.concatenate([fall - _cross(w, v), -_cross(w, J * w) / J])}


def _stiff_attitude(t: Any, y: Values, params: Values) -> dict[str, Array]:
    R, w, k, J = y["R"], y["w"], params["k"], np.array(stiff_attitude.INERTIA)
    axis = np.array(stiff_attitude.AXIS, w.dtype)
    between = about(axis, stiff_attitude.SWING * np.sin(t)).T @ R
    skew = (between - between.T) / 2
    e = np.array([skew[2, 1], skew[0, 2], skew[1, 0]])
    return {"R": R @ cross_matrix(w), "w": (_cross(J * w, w) - k * (e + w)) / J}


def _actuator_lag(t: Any, y: Values, params: Values) -> dict[str, Array]:
    v, w, F, a = y["V"][:3], y["V"][3:], y["F"], y["a"]
    m, J, n = actuator_lag.MASS, np.array(actuator_lag.INERTIA), y["g"][2, :3]
    side = F * a
    force = np.array([side[0], side[1], F]) - 9.81 * m * n - m * _cross(w, v)
    torque = actuator_lag.ARM * np.array([side[1], -side[0], 0 * F]) - _cross(w, J * w)
    command = 9.81 * m * (1 + 0.1 * np.cos(0.7 * t)) - 2 * v[2]
    gimbals = [-0.3 * n[0] + 0.15 * w[1] + 0.02 * np.sin(t), -0.3 * n[1] - 0.15 * w[0] + 0.02 * np.cos(2 * t)]
    return {
        "g": _moved(y["g"], y["V"]),
        "V": np.concatenate([force / m, torque / J]),
        "F": (command - F) / params["tau"],
        "a": (np.array(gimbals) - a) / params["tau"],
    }


def _stiff_joint(t: Any, y: Values, params: Values) -> dict[str, Array]:
    places, speeds = [], []
    for g, V, point in zip((y["g1"], y["g2"]), (y["V1"], y["V2"]), stiff_joint.POINTS):
        places.append(g[:3, 3] + g[:3, :3] @ point)
        speeds.append(g[:3, :3] @ (V[:3] + _cross(V[3:], point)))
    pull = params["k"] * (places[1] - places[0]) + params["c"] * (speeds[1] - speeds[0])
    found = {}
    for i, force in enumerate((pull, -pull)):
        g, V, m, J = y[f"g{i + 1}"], y[f"V{i + 1}"], stiff_joint.MASSES[i], np.array(stiff_joint.MOMENTS[i])
        torque = g[:3, :3].T @ _cross((places[0] + places[1]) / 2 - g[:3, 3], force)
        linear = g[:3, :3].T @ force / m - _cross(V[3:], V[:3])
        found[f"g{i + 1}"] = _moved(g, V)
        found[f"V{i + 1}"] = np.concatenate([linear, (torque - _cross(V[3:], J * V[3:])) / J])
    return found


@dataclasses.dataclass(frozen=True)
class Reference:
    """How the end of a scene is found.

    Attributes:
        scenes: the scene, once for each set of numbers for which the end is stored.
        rates: rates of the states as plain numbers, from (t, states, parameters).
        steps: that suffice.
        fastest: of a stiff scene the rate of the fastest transient, 1/s, from the parameters; else None.
    """

    scenes: tuple[Scene, ...]
    rates: Callable[[Any, Values, Values], dict[str, Array]]
    steps: int
    fastest: Callable[[Values], float] | None = None

    def end(self, scene: Scene, steps: int | None = None) -> dict[str, Array]:
        """The end of one of the scenes, in extended precision."""
        rate, start, unpack = self.flat(scene)
        y0, steps = start.astype(np.longdouble), steps or self.steps
        if self.fastest is None:
            return unpack(extrapolated(rate, y0, scene.duration, steps))
        return unpack(collocated(rate, y0, scene.duration, steps, self.fastest(scene.params)))

    def flat(self, scene: Scene) -> tuple[Callable[[Any, Array], Array], Array, Callable[[Array], dict[str, Array]]]:
        """Rates and start as vectors, in the order and the shapes of the start, and how to read one."""
        shapes = {name: np.shape(value) for name, value in scene.start.items()}
        ends = np.cumsum([int(np.prod(shape)) for shape in shapes.values()])

        def pack(y: Mapping[str, Any]) -> Array:
            return np.concatenate([np.ravel(y[name]) for name in shapes])

        def unpack(vector: Array) -> dict[str, Array]:
            parts = np.split(vector, ends[:-1])
            return {name: part.reshape(shape) for (name, shape), part in zip(shapes.items(), parts)}

        return lambda t, y: pack(self.rates(t, unpack(y), scene.params)), pack(scene.start), unpack


#: By the name of the scene.
REFERENCES = {
    "heavy-top": Reference((heavy_top.HEAVY_TOP,), _heavy_top, 300),
    "rocket": Reference((rocket.ROCKET,), _rocket, 100),
    "low-orbit": Reference((low_orbit.LOW_ORBIT,), _orbit(low_orbit.INERTIA), 100),
    "spinning-satellite": Reference((low_orbit.SPINNING_SATELLITE,), _orbit(low_orbit.SPINNING_INERTIA), 24_000),
    "spring-bodies": Reference((spring_bodies.SPRING_BODIES,), _spring_bodies, 150),
    "tumbling-brick": Reference((tumbling_brick.TUMBLING_BRICK,), _tumbling_brick, 100),
    "stiff-attitude": Reference(
        tuple(map(stiff_attitude.scene, stiff_attitude.RATES)), _stiff_attitude, 100, lambda params: float(params["k"])
    ),
    "actuator-lag": Reference(
        tuple(map(actuator_lag.scene, actuator_lag.LAGS)), _actuator_lag, 100, lambda params: float(1 / params["tau"])
    ),
    "stiff-joint": Reference((stiff_joint.STIFF_JOINT,), _stiff_joint, 200, lambda params: 2e5),
}


# ---- extrapolation --------------------------------------------------------------------------------------------------


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


def _print(scene: Scene, steps: int, coarse: Values, fine: Values) -> None:
    """Print the end of a scene as Python, and how far those of two step sizes are apart."""
    apart = max(float(np.max(np.abs(fine[s] - coarse[s]) / max(1.0, float(np.max(np.abs(fine[s])))))) for s in fine)
    values = ", ".join(f"{name} = {value:g}" for name, value in scene.params.items() if value.shape == ())
    which = f"{scene.name}, {values}" if values else scene.name
    print(f"# {which}: {steps} and {3 * steps // 2} steps are {apart:.1e} apart")
    for state, value in fine.items():
        print(f'    "{state}": np.array({value.astype(float).tolist()}),')


def main(arguments: list[str] | None = None) -> int:
    """Print the ends as Python."""
    parser = argparse.ArgumentParser(prog="python -m twistax.scenes.references", description=__doc__.split("\n")[0])
    parser.add_argument("scenes", nargs="*", metavar="SCENE", help=f"of {', '.join(REFERENCES)}; all if left out")
    names = parser.parse_args(arguments).scenes or list(REFERENCES)
    for name in names:
        if name not in REFERENCES:
            parser.error(f"no scene {name!r} here; there are {', '.join(REFERENCES)}")
    for how in (REFERENCES[name] for name in names):
        for scene in how.scenes:
            _print(scene, how.steps, how.end(scene), how.end(scene, 3 * how.steps // 2))
    return 0


if __name__ == "__main__":
    sys.exit(main())
