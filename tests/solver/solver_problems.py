"""Problems in stages with their starts: each has what the others have not."""

import casadi as ca
import numpy as np
from numpy import ndarray as Array
from solver_stages import Stage, Staged

NODES = 21
AT_REST = ([0.0, 0.0], [0.0, 0.0])
ANYWHERE = (-np.inf, np.inf)


def least_time() -> tuple[Staged, Array]:
    """A unit mass moved by 1 in least time, |u| <= 1: time 2. The time is a parameter."""
    h = lambda p: p[0] / (NODES - 1)  # noqa: E731
    stages = [
        Stage(
            *(2, 1),
            after=lambda x, u, p: [x[0] + h(p) * x[1] + h(p) ** 2 / 2 * u[0], x[1] + h(p) * u[0]],
            states_within=ANYWHERE if k else AT_REST,
            controls_within=(-1.0, 1.0),
        )
        for k in range(NODES - 1)
    ]
    stages.append(Stage(2, cost=lambda x, u, p: p[0], equalities=lambda x, u, p: [x[0] - 1, x[1]]))
    start = np.linspace([0.0, 0.0, 0.0], [1.0, 0.0, 0.0], NODES).ravel()[:-1]
    return Staged(stages, [(0.1, 6.0)]), np.append(start, 3.0)


def gate() -> tuple[Staged, Array]:
    """A free start on a curve, a row at an inner node, rows of states, a free and a fixed parameter."""

    def stage(k: int) -> Stage:
        rows = {0: lambda x, u, p: [x[0] * x[1] - 0.1], 10: lambda x, u, p: [x[0] - 0.8]}
        return Stage(
            *(2, 1),
            cost=lambda x, u, p: 0.1 * (u[0] ** 2 + 0.1 * x[0] ** 2),
            after=lambda x, u, p: [x[0] + 0.1 * x[1], x[1] + 0.1 * (u[0] - ca.sin(x[0]) + p[1])],
            inequalities=lambda x, u, p: [x[1] - 1.2 - p[0]],
            equalities=rows.get(k, lambda x, u, p: []),
        )

    last = Stage(2, cost=lambda x, u, p: p[0] ** 2 + x[1] ** 2, equalities=lambda x, u, p: [x[0] - 1 + p[0]])
    start = np.append(np.full(3 * (NODES - 1) + 2, 0.3), [0.0, 0.25])
    return Staged([*map(stage, range(NODES - 1)), last], [(-0.5, 0.5), (0.25, 0.25)]), start


def two_phases() -> tuple[Staged, Array]:
    """Two states, then three: a stage without controls links the phases; both durations are parameters."""
    first = [
        Stage(
            *(2, 1),
            cost=lambda x, u, p: p[0] / 10 * u[0] ** 2,
            after=lambda x, u, p: [x[0] + p[0] * x[1] / 10, x[1] + p[0] * u[0] / 10],
            states_within=ANYWHERE if k else AT_REST,
            controls_within=(-2.0, 2.0),
        )
        for k in range(10)
    ]
    link = Stage(2, after=lambda x, u, p: [x[0], x[1], 1.0], inequalities=lambda x, u, p: [0.2 - x[0]])
    burn = lambda x, u, p: [  # noqa: E731
        x[0] + p[1] * x[1] / 8,
        x[1] + p[1] * (u[0] - 0.2 * x[1]) / 8,
        x[2] - p[1] * 0.1 * (u[0] ** 2 + u[1] ** 2) / 8 + 0.01 * u[1],
    ]
    second = [
        Stage(3, 2, cost=lambda x, u, p: p[1] / 8 * ca.sumsqr(u), after=burn, controls_within=(-3.0, 3.0))
        for _ in range(8)
    ]
    last = Stage(
        3,
        cost=lambda x, u, p: p[0] + p[1] - x[2],
        inequalities=lambda x, u, p: [0.5 - x[2]],
        equalities=lambda x, u, p: [x[0] - 1, x[1]],
    )
    problem = Staged([*first, link, *second, last], [(0.2, 5.0), (0.2, 5.0)])
    start = np.full(problem.stages.variables, 0.3)
    start[:2], start[-2:] = 0.0, 1.0
    return problem, start


def swing_up() -> tuple[Staged, Array]:
    """A pendulum on a cart from hanging to upright, forward Euler, limits of force and track."""
    step, count = 0.05, 40

    def after(x: ca.SX, u: ca.SX, p: ca.SX) -> list[ca.SX]:
        s, c = ca.sin(x[1]), ca.cos(x[1])
        d = 1.0 + 0.3 * s * s
        cart = (0.15 * s * x[3] ** 2 + u[0] + 0.3 * 9.81 * c * s) / d
        pole = -(0.15 * c * s * x[3] ** 2 + u[0] * c + 1.3 * 9.81 * s) / (0.5 * d)
        return [x[0] + step * x[2], x[1] + step * x[3], x[2] + step * cart, x[3] + step * pole]

    goal = [1.0, np.pi, 0.0, 0.0]
    track = ([-2.0, -np.inf, -np.inf, -np.inf], [2.0, np.inf, np.inf, np.inf])
    stages = [
        Stage(
            *(4, 1),
            cost=lambda x, u, p: step * u[0] ** 2,
            after=after,
            states_within=track if k else ([0.0] * 4, [0.0] * 4),
            controls_within=(-20.0, 20.0),
        )
        for k in range(count)
    ]
    stages.append(Stage(4, equalities=lambda x, u, p: [x[i] - goal[i] for i in range(4)], states_within=track))
    return Staged(stages), np.linspace([0.0] * 5, [*goal, 0.0], count + 1).ravel()[:-1]


PROBLEMS = {f.__name__: f for f in (least_time, gate, two_phases, swing_up)}


def too_fast(duration: float) -> tuple[Staged, Array]:
    """A unit mass moved by 1 with |u| <= 1 in a given time: infeasible below 2."""
    h = duration / (NODES - 1)
    stages = [
        Stage(
            *(2, 1),
            cost=lambda x, u, p: u[0] ** 2,
            after=lambda x, u, p: [x[0] + h * x[1] + h**2 / 2 * u[0], x[1] + h * u[0]],
            states_within=ANYWHERE if k else AT_REST,
            controls_within=(-1.0, 1.0),
        )
        for k in range(NODES - 1)
    ]
    stages.append(Stage(2, equalities=lambda x, u, p: [x[0] - 1, x[1]]))
    return Staged(stages), np.zeros(3 * (NODES - 1) + 2)
