"""The true ends of the scenes without a closed form, found again in extended precision.

    python tests/scenes/scene_references.py [SCENE ...]

prints them as `ends.json` stores them, and how far two step sizes are apart. Nothing here uses the package's
expressions or integrators: the equations are NumPy, solved by extrapolation of the modified midpoint rule (Gragg,
Bulirsch, Stoer; Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, section II.9), stiff ones by
collocation, in NumPy's longest float. On x86 that is 64 bits of mantissa, 1e-19; elsewhere it may be a double, and
the last digits differ.
"""

import argparse
import dataclasses
import functools
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from twistax.mechanics import environment
from twistax.scenes import (
    Scene,
    actuator_lag,
    check_cases,
    heavy_top,
    low_orbit,
    rocket,
    spring_bodies,
    stiff_attitude,
    stiff_joint,
)
from twistax.scenes import scene as tools

about, cross_matrix, Array = tools.about, tools.cross_matrix, np.ndarray

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


def _body(g: Array, V: Array, m: Any, J: Array, force: Array, torque: Array) -> tuple[Array, Array]:
    """The rates of a pose and a twist about the centre of mass, under a force (3,) and a torque (3,) in body axes."""
    v, w = V[:3], V[3:]
    return _moved(g, V), np.concatenate([force / m - _cross(w, v), (torque - _cross(w, J * w)) / J])


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
    torque = np.array([roll, pitch, yaw]) - rocket.MASS_FLOW * k * w
    g, V = _body(y["g"], y["V"], m, m * k, force, torque)
    return {"g": g, "V": V, "m": np.asarray(rocket.MASS_FLOW)}


def _gravity(p: Array, gm: float, radius: float, j2: float) -> Array:
    """Gravity (3,) of a point mass and the second zonal harmonic."""
    r = np.sqrt(p @ p)
    z = p[2] / r
    pull = np.array([1 - 5 * z**2, 1 - 5 * z**2, 3 - 5 * z**2])
    return -gm / r**3 * (p + 1.5 * j2 * (radius / r) ** 2 * pull * p)


def _orbit(inertia: Sequence[float], t: Any, y: Values, params: Values) -> dict[str, Array]:
    J, earth, w, p = np.array(inertia), low_orbit.EARTH, y["w"], y["p"]
    r = np.sqrt(p @ p)
    down = -(y["R"].T @ p) / r
    w_rate = (3 * earth.gm / r**3 * _cross(down, J * down) - _cross(w, J * w)) / J
    v_rate = _gravity(p, earth.gm, earth.radius, earth.j2)
    return {"R": y["R"] @ cross_matrix(w), "w": w_rate, "p": y["v"], "v": v_rate}


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
        found[f"g{i + 1}"], found[f"V{i + 1}"] = _body(g, V, m, J, g[:3, :3].T @ pull[:3], pull[3:])
    return found


def _tumbling_brick(t: Any, y: Values, params: Values) -> dict[str, Array]:
    earth, g = environment.gravity.EARTH_J2, y["g"]
    fall = g[:3, :3].T @ _gravity(g[:3, 3], earth.gm, earth.radius, earth.j2)
    return dict(zip(("g", "V"), _body(g, y["V"], 1, params["inertia"], fall, np.zeros(3))))


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
    force = np.array([side[0], side[1], F]) - 9.81 * m * n
    torque = actuator_lag.ARM * np.array([side[1], -side[0], 0 * F])
    g, V = _body(y["g"], y["V"], m, J, force, torque)
    command = 9.81 * m * (1 + 0.1 * np.cos(0.7 * t)) - 2 * v[2]
    gimbals = [-0.3 * n[0] + 0.15 * w[1] + 0.02 * np.sin(t), -0.3 * n[1] - 0.15 * w[0] + 0.02 * np.cos(2 * t)]
    return {"g": g, "V": V, "F": (command - F) / params["tau"], "a": (np.array(gimbals) - a) / params["tau"]}


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
        found[f"g{i + 1}"], found[f"V{i + 1}"] = _body(g, V, m, J, g[:3, :3].T @ force, torque)
    return found


@dataclasses.dataclass(frozen=True)
class Reference:
    """How the end of a scene is found."""

    scenes: tuple[Scene, ...]  # once for each set of numbers for which the end is stored
    rates: Callable[[Any, Values, Values], dict[str, Array]]  # of the states, from (t, states, parameters)
    steps: int  # that suffice
    fastest: Callable[[Values], float] | None = None  # of a stiff scene, from parameters: its fastest rate, 1/s

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
    "low-orbit": Reference((low_orbit.LOW_ORBIT,), functools.partial(_orbit, low_orbit.INERTIA), 100),
    "spinning-satellite": Reference(
        (low_orbit.SPINNING_SATELLITE,), functools.partial(_orbit, low_orbit.SPINNING_INERTIA), 24_000
    ),
    "spring-bodies": Reference((spring_bodies.SPRING_BODIES,), _spring_bodies, 150),
    "tumbling-brick": Reference((check_cases.TUMBLING_BRICK,), _tumbling_brick, 100),
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


# ---- stiff equations: Radau IIA of nine stages, order 17 -----------------------------------------------------------
# Stages and what they must satisfy are in extended precision; Newton's corrections, which only have to be roughly
# right, are solved for in doubles. Source: Hairer and Wanner, Solving Ordinary Differential Equations II, sections IV.5
# and IV.8.

_STAGES = 9
_ROUNDS = 40  # of Newton's method; it gains two or more digits in each
_GROWTH = 1.3  # a step over the one before while a transient dies away


def collocated(rate: Callable[[Any, Array], Array], y0: Array, duration: float, steps: int, fastest: float) -> Array:
    """y(duration) of y' = rate(t, y), in the precision of y0.

    Args:
        steps: how many there would be without the short ones at the start.
        fastest: rate of the fastest transient, 1/s. The first step is a tenth of its time.
    Raises:
        ArithmeticError: Newton's method does not converge.
    """
    y, t = y0, y0.dtype.type(0)
    for h in _lengths(y0.dtype.type(duration), steps, fastest):
        y, t = _step(rate, t, y, h), t + h
    return y


def _lengths(duration: Any, steps: int, fastest: float) -> Iterator[Any]:
    """Lengths of steps from a tenth of the fastest time up to duration / steps, and equal ones from there."""
    longest, left = duration / steps, duration
    h = min(longest, duration.dtype.type(0.1) / fastest)
    while h < longest:
        yield h
        left, h = left - h, _GROWTH * h
    count = int(np.ceil(left / longest))
    yield from (left / count for _ in range(count))


def _step(rate: Callable[[Any, Array], Array], t: Any, y: Array, h: Any) -> Array:
    """One step: the stages z_i = h sum_j a_ij rate(t + c_j h, y + z_j) as deviations from y, the last one the end."""
    c, a = radau(_STAGES)
    inverse = np.linalg.inv(np.eye(_STAGES * y.size) - np.kron((h * a).astype(float), _jacobian(rate, t, y)))
    z, last = np.zeros((_STAGES, y.size), y.dtype), np.inf
    for _ in range(_ROUNDS):
        found = np.stack([rate(t + node * h, y + stage) for node, stage in zip(c, z)])
        wrong = z - h * (a @ found)
        change = (inverse @ wrong.astype(float).ravel()).reshape(z.shape)
        z = z - change
        size = float(np.max(np.abs(change) / np.maximum(1.0, np.abs(y + z).astype(float))))
        # Small and no longer falling: what is left is round-off, which stiffness makes larger.
        if size == 0.0 or (size < 1e-13 and size > 0.5 * last):
            return y + z[-1]
        last = size
    raise ArithmeticError(f"Newton's method does not converge in the step of {float(h):g} s from t = {float(t):g} s")


def _jacobian(rate: Callable[[Any, Array], Array], t: Any, y: Array) -> Array:
    """By central differences."""
    columns = []
    for i in range(y.size):
        d = np.zeros_like(y)
        d[i] = 1e-6 * max(1.0, abs(float(y[i])))
        columns.append((rate(t, y + d) - rate(t, y - d)) / (2 * d[i]))
    return np.stack(columns, axis=1).astype(float)


@functools.cache
def radau(stages: int) -> tuple[Array, Array]:
    """Nodes c (n,) and weights a (n, n) of Radau IIA in extended precision.

    The nodes in [-1, 1] are the roots of P_n - P_(n-1), found by Newton's method. An interpolant in Legendre
    polynomials through them has the coefficients (2 j + 1) / 2 sum_i w_i P_j(x_i) f_i, since the rule is exact for the
    products of two polynomials of degree n - 1, and is integrated term by term.
    """
    x = np.sort(np.roots(np.polynomial.legendre.leg2poly([0] * (stages - 1) + [-1, 1])[::-1]).real)
    x = x.astype(np.longdouble)
    for _ in range(4):
        p, slope = _legendre(stages, x)
        x[:-1] -= ((p[-1] - p[-2]) / (slope[-1] - slope[-2]))[:-1]
        x[-1] = 1
    p, _ = _legendre(stages, x)
    w = (1 + x) / (stages * p[stages - 1]) ** 2
    degrees = np.arange(stages)[:, None]
    coefficients = (2 * degrees + 1) / np.longdouble(2) * p[:stages] * w
    # The integral of P_j from -1 to x is (P_(j+1) - P_(j-1)) / (2 j + 1), with P_(-1) = -1.
    below = np.concatenate([-np.ones((1, stages), np.longdouble), p[: stages - 1]])
    integrals = (p[1:] - below) / (2 * degrees + 1)
    return (1 + x) / 2, integrals.T @ coefficients / 2


def _legendre(degree: int, x: Array) -> tuple[Array, Array]:
    """P_0 to P_degree at x, and their derivatives: (degree + 1, n) each."""
    p, slope = [np.ones_like(x), x], [np.zeros_like(x), np.ones_like(x)]
    for j in range(1, degree):
        p.append(((2 * j + 1) * x * p[j] - j * p[j - 1]) / (j + 1))
        slope.append(slope[j - 1] + (2 * j + 1) * p[j])
    return np.stack(p), np.stack(slope)


def main(arguments: list[str] | None = None) -> int:
    """Print the ends as `ends.json` has them, and how far those of two step sizes are apart."""
    parser = argparse.ArgumentParser(prog="python tests/scenes/scene_references.py", description=__doc__.split("\n")[0])
    parser.add_argument("scenes", nargs="*", metavar="SCENE", help=f"of {', '.join(REFERENCES)}; all if left out")
    names = parser.parse_args(arguments).scenes or list(REFERENCES)
    for name in names:
        if name not in REFERENCES:
            parser.error(f"no scene {name!r} here; there are {', '.join(REFERENCES)}")
    for how in (REFERENCES[name] for name in names):
        for scene in how.scenes:
            more = 3 * how.steps // 2
            coarse, fine = how.end(scene), how.end(scene, more)
            apart = max(np.max(np.abs(end - coarse[s])) / max(1.0, np.max(np.abs(end))) for s, end in fine.items())
            numbers = [f"{name} = {float(value)!r}" for name, value in scene.params.items() if value.shape == ()]
            print(f"# {', '.join([scene.name, *numbers])}: {how.steps} and {more} steps are {apart:.1e} apart")
            print(*(f'    "{state}": {value.astype(float).tolist()}' for state, value in fine.items()), sep=",\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
