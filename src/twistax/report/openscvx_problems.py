"""Trajectory problems in OpenSCvx: a separate program, because OpenSCvx sets the precision of JAX for the whole
process.

`python -m twistax.report.openscvx_problems '{"name": "goddard", "nodes": 51, "settings": [{}]}'` prints the result of
each settings of `openscvx.Problem`, as JSON; `uniform` among them is `Time.uniform_time_grid`. OpenSCvx scales every
state and control by its limits. Where a problem has none they lie beyond the optimum, mostly by half of what it
reaches.
"""

from __future__ import annotations

import contextlib
import dataclasses
import io
import json
import sys
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np
import openscvx as ox
from openscvx.symbolic.lower import lower_to_jax

#: Where an end is free, with a guess; and the cost, a state that is least at the end.
_FREE, _COST = ("free", 0.0), "cost"
_POINTS = 20


@dataclasses.dataclass(frozen=True)
class StatedProblem:
    """What `openscvx.Problem` takes; `value` is the state whose end is the objective, `time` a duration or its guess
    and longest."""

    states: list[Any]
    controls: list[Any]
    rates: dict[str, Any]
    time: float | tuple[float, float]
    value: str = _COST
    constraints: Sequence[Any] = ()


def _state(name: str, low: Any, high: Any, initial: Any, final: Any) -> Any:
    state = ox.State(name, shape=np.shape(np.atleast_1d(initial)))
    state.min, state.max, state.initial = (
        np.broadcast_to(np.asarray(a, float), state.shape) for a in (low, high, initial)
    )
    state.final = [final] if isinstance(final, (tuple, float)) else final
    return state


def _cost(high: float) -> Any:
    return _state(_COST, 0.0, high, 0.0, ("minimize", 0.0))


def _control(name: str, nodes: int, low: Any, high: Any, guess: Any = None) -> Any:
    control = ox.Control(name, shape=np.shape(np.atleast_1d(low)))
    control.min, control.max = np.atleast_1d(low).astype(float), np.atleast_1d(high).astype(float)
    control.guess = np.tile(0.5 * (control.min + control.max) if guess is None else guess, (nodes, 1))
    return control


def fastest(nodes: int) -> StatedProblem:
    """Least time of p'' = u."""
    p, v = _state("p", -1.0, 2.0, 0.0, 1.0), _state("v", -2.0, 2.0, 0.0, 0.0)
    u = _control("u", nodes, -1.0, 1.0)
    return StatedProblem([p, v], [u], {"p": v, "v": u}, (3.25, 6.0), "time")


def brachistochrone(nodes: int) -> StatedProblem:
    """Fastest slide."""
    x, y = _state("x", 0.0, 15.0, 0.0, 10.0), _state("y", 0.0, 10.0, 10.0, 5.0)
    v, angle = _state("v", 0.0, 15.0, 0.0, _FREE), _control("angle", nodes, 0.01, 3.13)
    rates = {"x": v * ox.Sin(angle), "y": -v * ox.Cos(angle), "v": 9.80665 * ox.Cos(angle)}
    return StatedProblem([x, y, v], [angle], rates, (5.25, 10.0), "time")


def bryson_denham(nodes: int) -> StatedProblem:
    """Least effort below a ceiling."""
    x, v = _state("x", -0.2, 1.0 / 9.0, 0.0, 0.0), _state("v", -1.5, 1.5, 1.0, -1.0)
    u = _control("u", nodes, -10.0, 10.0)
    return StatedProblem([x, v, _cost(8.0)], [u], {"x": v, "v": u, _COST: 0.5 * u**2}, 1.0)


def goddard(nodes: int) -> StatedProblem:
    """How high a rocket climbs."""
    h, v = _state("h", 1.0, 1.1, 1.0, ("maximize", 1.0)), _state("v", 0.0, 0.5, 0.0, _FREE)
    m, thrust = _state("m", 0.6, 1.0, 1.0, 0.6), _control("T", nodes, 0.0, 3.5)
    force = thrust - 310.0 * v**2 * ox.Exp(-500.0 * (h - 1.0))
    rates = {"h": v, "v": force / m - 1.0 / h**2, "m": -thrust / 0.5}
    return StatedProblem([h, v, m], [thrust], rates, (0.2, 0.6), "h")


def cart_pole(nodes: int) -> StatedProblem:
    """Swing-up by least squared force."""
    cart, pole, g, length = 1.0, 0.3, 9.81, 0.5
    q, a = _state("q", -2.0, 2.0, 0.0, 1.0), _state("a", -5.0, 5.0, 0.0, np.pi)
    dq, da = _state("dq", -4.0, 4.0, 0.0, 0.0), _state("da", -12.0, 12.0, 0.0, 0.0)
    u, sine, cosine = _control("u", nodes, -20.0, 20.0), ox.Sin(a), ox.Cos(a)
    mass = cart + pole * sine**2
    rates = {
        "q": dq,
        "a": da,
        "dq": (length * pole * sine * da**2 + u + pole * g * cosine * sine) / mass,
        "da": -(length * pole * cosine * sine * da**2 + u * cosine + (cart + pole) * g * sine) / (length * mass),
        _COST: u**2,
    }
    return StatedProblem([q, a, dq, da, _cost(120.0)], [u], rates, 2.0)


def rendezvous(nodes: int) -> StatedProblem:
    """Least fuel to rest: |u| <= s <= 1."""
    x = _state("x", -6.0, 6.0, [4.0, -2.0, 1.0], [0.0, 0.0, 0.0])
    v = _state("v", -1.0, 1.0, [0.0, 0.5, -0.2], [0.0, 0.0, 0.0])
    u, s = _control("u", nodes, [-1.0] * 3, [1.0] * 3), _control("s", nodes, 0.0, 1.0)
    limit = (ox.linalg.Norm(u) <= s[0]).convex()
    return StatedProblem([x, v, _cost(2.5)], [u, s], {"x": v, "v": u, _COST: s}, 8.0, constraints=[limit])


def reorientation(nodes: int) -> StatedProblem:
    """Fastest half turn of a ball; its guess turns at a constant rate."""
    q = _state("q", -1.1, 1.1, [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0])
    w, u = _state("w", -2.5, 2.5, [0.0] * 3, [0.0] * 3), _control("u", nodes, [-1.0] * 3, [1.0] * 3)
    half = np.linspace(0.0, 0.5 * np.pi, nodes)
    q.guess = np.stack([np.cos(half), 0.0 * half, 0.0 * half, np.sin(half)], axis=1)
    return StatedProblem([q, w], [u], {"q": 0.5 * ox.spatial.SSMP(w) @ q, "w": u}, (3.5, 6.0), "time")


def quadrotor(nodes: int) -> StatedProblem:
    """A quadrotor past three spheres."""
    mass, J, arm, twist = 0.8, np.array([5e-3, 5e-3, 9e-3]), 0.17, 0.016
    mixer = np.array([[1, 1, 1, 1], [0, arm, 0, -arm], [-arm, 0, arm, 0], [twist, -twist, twist, -twist]])
    p = _state("p", [-2.0] * 3, [10.0, 2.0, 2.0], [0.0] * 3, [8.0, 0.0, 0.0])
    q = _state("q", -1.1, 1.1, [1.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0])
    v, w = (_state(name, -15.0, 15.0, [0.0] * 3, [0.0] * 3) for name in ("v", "w"))
    rotors = _control("rotors", nodes, [0.3] * 4, [4.5] * 4, np.full(4, mass * 9.81 / 4.0))
    lift, R = mixer @ rotors, ox.spatial.QDCM(q)
    force = R.T @ np.array([0.0, 0.0, -9.81]) + ox.Concat(0.0, 0.0, lift[0] / mass)
    rates = {
        "p": R @ v,
        "q": 0.5 * ox.spatial.SSMP(w) @ q,
        "v": force - ox.spatial.SSM(w) @ v,
        "w": np.diag(1.0 / J) @ (lift[1:] - ox.spatial.SSM(w) @ (np.diag(J) @ w)),
    }
    spheres = (((2.0, 0.4, 0.3), 0.9), ((4.2, -0.5, -0.2), 1.0), ((6.3, 0.2, 0.5), 0.8))
    past = [(p - np.array(place)).T @ (p - np.array(place)) >= radius**2 for place, radius in spheres]
    return StatedProblem([p, q, v, w], [rotors], rates, (4.25, 8.0), "time", past)


_PROBLEMS: dict[str, Callable[[int], StatedProblem]] = {
    statement.__name__: statement
    for statement in (fastest, brachistochrone, bryson_denham, goddard, cart_pole, rendezvous, reorientation, quadrotor)
}


def solved(name: str, nodes: int, uniform: bool = False, **settings: Any) -> dict[str, Any]:
    """A solve with one choice of settings, in plain values: how it ended, its nodes, and the statement as the
    problem has it."""
    statement = _PROBLEMS[name](nodes)
    last: dict[str, Any] = {"final": statement.time, "max": statement.time}
    if isinstance(statement.time, tuple):
        kind = "minimize" if statement.value == "time" else "free"
        last = {"final": (kind, statement.time[0]), "max": statement.time[1]}
    time = ox.Time(initial=0.0, min=0.0, uniform_time_grid=uniform, **last)
    arguments = (statement.rates, list(statement.constraints), statement.states, statement.controls, nodes, time)
    problem = ox.Problem(*arguments, **settings)
    problem.settings.dev.printing = False
    problem.initialize()
    result = problem.solve()
    return {
        "converged": bool(result.converged),
        "value": float(np.squeeze(result.nodes[statement.value][-1])),
        "iterations": problem.state.k - 1,
        "initialize": problem.timing_init,
        "solve": problem.timing_solve,
        "nodes": {name: np.asarray(values).tolist() for name, values in result.nodes.items()},
        "stated": _read(problem, statement) if "float_dtype" in settings else None,
    }


def _read(problem: Any, statement: StatedProblem) -> dict[str, Any]:
    """Ends, limits and rates as the problem has them, rates and constraints at random points."""
    rng, where = np.random.default_rng(0), problem.slices
    x, u = (np.zeros((_POINTS, len(vector.max))) for vector in (problem.x_unified, problem.u_unified))
    leaves = {leaf.name: leaf for leaf in (*statement.states, *statement.controls)}
    for values, parts in ((x, statement.states), (u, statement.controls)):
        for leaf in parts:
            spot = rng.uniform(0.1, 0.9, (_POINTS, *leaf.shape)) * (leaf.max - leaf.min) + leaf.min
            # Quaternions.
            values[:, where[leaf.name]] = spot / np.linalg.norm(spot, axis=1)[:, None] if leaf.shape == (4,) else spot
    u[:, problem.settings.sim.time_dilation_slice] = 1.0
    functions = [problem.lowered.dynamics.f, *(lower_to_jax(c.lhs - c.rhs) for c in statement.constraints)]
    rates, *limits = jax.jit(jax.vmap(lambda a, b: [f(a, b, 0, {}) for f in functions]))(x, u)
    ends = {s.name: [_fixed(s.initial, s.initial_type), _fixed(s.final, s.final_type)] for s in statement.states}
    return {
        "points": {n: (u if isinstance(e, ox.Control) else x)[:, where[n]].tolist() for n, e in leaves.items()},
        "rates": {s.name: rates[:, where[s.name]].tolist() for s in statement.states},
        "constraints": [np.ravel(values).tolist() for values in limits],
        "ends": ends,
        "limits": {n: [leaf.min.tolist(), leaf.max.tolist()] for n, leaf in leaves.items()},
        "time": statement.time,
    }


def _fixed(values: Any, kinds: Any) -> list[float | None]:
    return [float(value) if kind == "Fix" else None for value, kind in zip(values, kinds, strict=True)]


def main(request: str) -> None:
    """Print the results of all settings as JSON, and nothing else."""
    options = json.loads(request)
    with contextlib.redirect_stdout(io.StringIO()):
        answers = [solved(options["name"], options["nodes"], **settings) for settings in options["settings"]]
    print(json.dumps(answers))


if __name__ == "__main__":
    main(sys.argv[1])
