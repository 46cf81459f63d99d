"""Solutions by SciPy of equations written out in NumPy: the truth of a scene, found another way."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from oracles import skew
from twistax.scenes import scene

about, rotation_angle = scene.about, scene.rotation_angle

Array = np.ndarray
Rates = Callable[[Any, Mapping[str, Array]], dict[str, Array]]


def scipy_solution(rates: Rates, start: Mapping[str, Any], t0: float, t1: float) -> dict[str, Array]:
    """The states at t1 by DOP853 near round-off. Matrices are integrated entry by entry."""
    shapes = {name: np.shape(value) for name, value in start.items()}
    ends = np.cumsum([int(np.prod(shape)) for shape in shapes.values()])[:-1]

    def unpacked(y: Array) -> dict[str, Array]:
        return {name: part.reshape(shape) for (name, shape), part in zip(shapes.items(), np.split(y, ends))}

    def rate(t: float, y: Array) -> Array:
        found = rates(t, unpacked(y))
        return np.concatenate([np.ravel(found[name]) for name in shapes])

    y0 = np.concatenate([np.ravel(value) for value in start.values()]).astype(float)
    # One absolute tolerance for each state, 1e-15 of its size or of 1.
    atol = np.concatenate([np.full(np.size(v), 1e-15 * max(1.0, float(np.max(np.abs(v))))) for v in start.values()])
    solution = solve_ivp(rate, (t0, t1), y0, method="DOP853", rtol=1e-13, atol=atol)
    assert solution.success
    return unpacked(solution.y[:, -1])


def spinning(J: Any) -> Rates:
    """Euler's equations and R' = R [w]x."""
    J = np.asarray(J, float)

    def rates(t: float, y: Mapping[str, Array]) -> dict[str, Array]:
        W = skew(y["w"])
        return {"R": y["R"] @ W, "w": -(W @ (J * y["w"])) / J}

    return rates


def tumbling(center: Array, inertia: Array) -> Rates:
    """A free body about a point that is not its centre of mass: Newton for the centre, Euler about it."""

    def rates(t: float, y: Mapping[str, Array]) -> dict[str, Array]:
        R, v, w = y["g"][:3, :3], y["V"][:3], y["V"][3:]
        W = skew(w)
        # 0 = a_origin + w' x c + w x (w x c) with a_origin = v' + w x v;  0 = I w' + w x I w
        turning = np.linalg.solve(inertia, -W @ inertia @ w)
        moving = -W @ v - skew(turning) @ center - W @ W @ center
        rate = np.zeros((4, 4))
        rate[:3, :3], rate[:3, 3] = R @ W, R @ v
        return {"g": rate, "V": np.concatenate([moving, turning])}

    return rates
