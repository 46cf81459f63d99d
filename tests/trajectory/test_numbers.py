"""Numbers of a model are data: what differs in numbers, nodes, meshes or guesses alone compiles nothing."""

import os
import pickle
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import twistax as tx
from twistax.trajectory import Collocation, GaussNewton, Linear, Mesh, Phase, Problem, QuasiNewton

pytest.importorskip("llvmlite")


@pytest.fixture
def made() -> Iterator[list[str]]:
    """What is traced, compiled by XLA or made a kernel meanwhile."""
    found: list[str] = []

    def listen(event: str, seconds: float, **_: Any) -> None:
        found.append(event)

    jax.monitoring.register_event_duration_secs_listener(listen)
    yield found
    jax.monitoring.unregister_event_duration_listener(listen)


def pushed(mass: float = 1.3, limit: float = 0.8, nodes: Any = 9, distance: float = 1.0, **options: Any) -> Problem:
    """Least effort from rest to rest against drag, with limits and a norm in the cost."""
    p, v, u = tx.State("p"), tx.State("v", max=limit), tx.Control("u", shape=(2,), min=-6.0, max=6.0)
    rates = {p: v, v: (u[0] - 0.2 * u[1] - 0.15 * v * v) / mass}
    return Problem(
        tx.compile(tx.System(rates=rates, constraints={"ramp": p <= 1.05 * distance + limit * tx.Time()})),
        tx.Minimize(0.1 * mass * p**2, running=0.5 * mass * (u @ u) + 0.05 * limit * tx.linalg.Norm(u)),
        **{"nodes": nodes, "final_time": 2.0, "initial": {p: 0.0, v: 0.0}, "final": [{p: distance}, v <= 0.1 * limit]}
        | options,
    )


def turned(inertia: float = 2.0, nodes: Any = 8, reach: float = 1.1, **options: Any) -> Problem:
    """A body turns and passes a ball: a group, a node's condition and a free time."""
    R, w, x = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,)), tx.State("x", shape=(2,))
    u = tx.Control("u", shape=(3,), min=-3.0, max=3.0)
    J = np.array([[inertia, 0.1, 0.0], [0.1, 1.5, 0.2], [0.0, 0.2, 1.2]])
    rates = {R: w, w: np.linalg.inv(J) @ (u - tx.linalg.Cross(w, J @ w)), x: 0.9 * R[:2, 0]}
    clear = (x - np.array([0.8, 0.1])) @ (x - np.array([0.8, 0.1])) >= 0.01 * reach
    return Problem(
        tx.compile(tx.System(rates=rates, constraints={"clear": clear})),
        tx.Minimize(tx.Time() * 0.3 * reach, running=u @ u),
        **{"nodes": nodes, "final_time": (0.7, 4.0), "final_time_guess": 2.0, "at": {2: x[0] >= 0.1 * reach}}
        | {"initial": {R: np.eye(3), w: np.zeros(3), x: np.zeros(2)}, "final": [R[2, 2] <= 0.7, x[0] == reach]}
        | options,
    )


def staged(gravity: float = 9.81, split: float = 0.4, nodes: int = 6, **options: Any) -> Problem:
    """Two phases with a jump between them."""

    def phase(**own: Any) -> Phase:
        h, v, u = tx.State("h"), tx.State("v"), tx.Control("u", min=0.0, max=3.0 * gravity)
        dynamics = tx.compile(tx.System(rates={h: v, v: u - gravity}))
        return Phase(dynamics, tx.Minimize(running=u * u), nodes=nodes, final_time=0.8, **own)

    first = phase(initial={"h": 0.0, "v": 0.0})
    second = phase(final={"h": 1.0, "v": 0.0})
    v = tx.State("v")
    return Problem([first, second], links=[{v: split * v}], **options)


OTHERS: dict[str, tuple[Callable[..., Any], dict[str, Any]]] = {
    "a mass": (pushed, {"mass": 1.7}),
    "a limit": (pushed, {"limit": 0.9}),
    "an end": (pushed, {"distance": 1.2}),
    "a count of nodes": (pushed, {"nodes": 12}),
    "nodes elsewhere": (pushed, {"nodes": [0.0, 0.1, 0.25, 0.5, 0.6, 0.8, 1.0]}),
    "an inertia": (turned, {"inertia": 2.4}),
    "the place of a condition": (turned, {"reach": 1.15, "nodes": 10, "at": None}),
    "a gravity": (staged, {"gravity": 9.7}),
    "a link": (staged, {"split": 0.45, "nodes": 7}),
}


@pytest.mark.parametrize(("make", "other"), OTHERS.values(), ids=OTHERS.keys())
def test_another_number_compiles_nothing(make: Callable[..., Any], other: dict[str, Any], made: list[str]) -> None:
    first = make().solve()
    assert first.solved
    made.clear()
    result = make(**other).solve()
    assert made == []
    assert result.solved
    assert result.cost != pytest.approx(first.cost, rel=1e-6)


def test_guesses_and_ends_compile_nothing(made: list[str]) -> None:
    problem = pushed()
    assert problem.solve().solved
    made.clear()
    assert problem.solve(initial={"v": 0.3}).solved
    problem.solve(initial={"v": 0.79}, final={"p": 1.6}, max_iterations=40)  # it is restored on its way
    assert problem.solve(guess={"u": [5.0, -5.0]}, guesses=2, seed=1).solved
    assert problem.solve_many(initial={"v": np.array([0.0, 0.1, 0.2])}).solved.all()
    assert made == []


def test_the_first_elements_of_groups_as_ends_compile_nothing(made: list[str]) -> None:
    """Each group and precision for the first time in this process."""
    for group in (tx.SE3, tx.SO3):
        state = tx.State("g", group=group)
        state.boundary("initial", np.eye(*group.shape))
        group.identity(np.float32)
    assert made == []


def test_limits_between_nodes_compile_nothing(made: list[str]) -> None:
    assert turned().solve(between=1e-4).solved
    made.clear()
    assert turned(inertia=2.5, nodes=9).solve(between=1e-4).solved
    assert made == []


@pytest.mark.parametrize("make", [pushed, turned])
def test_rollouts_of_a_result_integrate_by_the_core(make: Callable[..., Any], made: list[str]) -> None:
    """What is compiled are the few conditions at nodes."""
    make().solve().replay()
    result = make(nodes=10).solve()
    made.clear()
    by_core = result.replay()
    assert sum("backend_compile" in event for event in made) <= len(by_core.final)
    by_jax = result.replay(result.problem.transcription.replaying)
    assert by_core.violations == pytest.approx(by_jax.violations, abs=1e-9)
    for name, values in by_jax.xs.items():
        np.testing.assert_allclose(by_core.xs[name], values, atol=1e-10)
        np.testing.assert_allclose(by_core.vectors[name], by_jax.vectors[name], atol=1e-10)


def test_finer_meshes_compile_nothing(made: list[str]) -> None:
    assert pushed().solve(refine=1e-3).solved
    made.clear()
    result = pushed(mass=1.5).solve(refine=1e-4)
    assert made == []
    assert len(result.meshes) > 1
    assert result.solved


WAYS: dict[str, dict[str, Any]] = {
    "linear controls": {"controls": Linear()},
    "collocation": {"transcription": Collocation(tx.tableaus.GAUSS_LEGENDRE4)},
    "free nodes": {"nodes": Mesh(7, free=True)},
}
HESSIANS: dict[str, dict[str, Any]] = {
    "Gauss-Newton": {"hessian": GaussNewton()},
    "quasi-Newton": {"hessian": QuasiNewton()},
}


@pytest.mark.parametrize("options", (WAYS | HESSIANS).values(), ids=(WAYS | HESSIANS).keys())
def test_other_transcriptions_too(options: dict[str, Any], made: list[str]) -> None:
    assert pushed(**options).solve().solved
    made.clear()
    assert pushed(mass=1.45, limit=0.85, **options).solve().solved
    assert made == []


def test_rows_of_other_nodes_compile_nothing(made: list[str]) -> None:
    q, c, costs = tx.State("q"), tx.Control("c"), list[float]()
    dynamics = tx.compile(tx.System(rates={q: c - 0.2 * q}))
    for nodes, wanted in ((6, tx.Parameter("wanted", value=0.0)), (9, tx.Parameter("other", value=1.0))):
        made.clear()
        cost = tx.Minimize((q - wanted) ** 2, running=c**2)
        problem = Problem(dynamics, cost, nodes=nodes, final_time=1.0, initial={q: 0.0}, by_node=[wanted])
        costs.append(problem.solve(params={wanted: np.linspace(0.0, 1.0, nodes)}).cost)
    assert made == []
    assert costs[1] == pytest.approx(costs[0], rel=1e-2)


def staged(masses: Sequence[float], durations: Sequence[float], nodes: int = 5) -> Problem:
    """A cart whose mass changes from phase to phase moves by 1 from rest to rest with least effort."""
    p, v, u = tx.State("p"), tx.State("v"), tx.Control("u")
    ends = [{"initial": {p: 0.0, v: 0.0}}, *({} for _ in masses[2:]), {"final": {p: 1.0, v: 0.0}}]
    phases = [
        Phase(
            tx.compile(tx.System(rates={p: v, v: u / mass})),
            tx.Minimize(running=u * u),
            nodes=nodes,
            final_time=duration,
            **end,
        )
        for mass, duration, end in zip(masses, durations, ends, strict=True)
    ]
    return Problem(phases)


def test_phases_with_other_numbers_share_kernels(made: list[str]) -> None:
    """The exact optimum has the smallest controls of those that reach the end, a linear system."""
    masses, durations, kernels = [1.0, 2.5, 0.7, 1.6], [0.5, 0.8, 0.4, 0.6], list[int]()
    for count in (2, 3, 4):  # the first solve also makes kernels that all problems share
        made.clear()
        result = staged(masses[:count], durations[:count]).solve()
        kernels.append(made.count("/twistax/kernel"))
    assert 0 < kernels[2] == kernels[1]
    widths, of_mass = np.repeat(durations, 4) / 4, np.repeat(masses, 4)
    left = np.cumsum(widths[::-1])[::-1] - 0.5 * widths  # from the middle of an interval to the end
    ends = np.stack([left, np.ones(16)]) * widths / of_mass
    cost = np.linalg.solve(ends / widths @ ends.T, [1.0, 0.0])[0]
    assert result.solved
    assert result.cost == pytest.approx(cost, rel=1e-8)


# ---- the numbers are the right ones -------------------------------------------------------------------------------


def as_parameter(mass: float) -> Problem:
    """`fall` with its number as a parameter."""
    return fall(tx.Parameter("mass", value=mass))


def fall(mass: Any) -> Problem:
    p, v, u = tx.State("p"), tx.State("v"), tx.Control("u", min=-4.0, max=4.0)
    return Problem(
        tx.compile(tx.System(rates={p: v, v: u * mass - 0.4 * v * mass + (p - mass)})),
        tx.Minimize(running=u * u + mass * p**2),
        nodes=8,
        final_time=1.5,
        initial={p: 0.2, v: 0.0},
        final={p: 1.0},
    )


@pytest.mark.parametrize("masses", [(0.7, 1.9, 1.0, 0.0, -0.6), (0.0, 1.0, -1.0, 0.5, 2.0)])
def test_numbers_that_become_zero_or_one_and_others(masses: tuple[float, ...]) -> None:
    """Beside the same number as a parameter, which is an argument of every function."""
    for mass in masses:
        found, expected = fall(mass).solve(), as_parameter(mass).solve()
        assert found.status is expected.status
        assert found.cost == pytest.approx(expected.cost, rel=1e-9, abs=1e-12)
        np.testing.assert_allclose(found.us["u"], expected.us["u"], atol=1e-6)


def test_problems_of_one_structure_keep_their_numbers() -> None:
    """Alive at once, in turn, in threads, and after a journey."""
    masses = [1.1, 1.3, 1.7, 2.2]
    problems = [pushed(mass) for mass in masses]
    costs = [problem.solve().cost for problem in problems]
    assert np.unique(np.round(costs, 6)).size == len(masses)
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda problem: problem.solve().cost, 3 * problems))
    np.testing.assert_allclose(together, 3 * costs, rtol=1e-12)
    travelled = [pickle.loads(pickle.dumps(problem)).solve().cost for problem in problems]
    np.testing.assert_allclose(travelled, costs, rtol=1e-12)
    assert problems[0].solve().cost == pytest.approx(costs[0], rel=1e-12)


def test_violations_are_of_the_limits_of_their_problem() -> None:
    """As they were written, of a point that exceeds them."""
    for distance in (1.0, 1.2):
        result = pushed(distance=distance, guess={"p": 3.0, "v": 1.5}).solve(max_iterations=1)
        excess = (result.xs["p"] - 1.05 * distance - 0.8 * result.ts).max()
        assert excess > 0.1
        assert result.violations["ramp"] == pytest.approx(excess, abs=1e-12)
        assert result.violations["v <= 0.8"] == pytest.approx(max(0.0, result.xs["v"].max() - 0.8), abs=1e-12)


ROLES: dict[str, tuple[Callable[[Any, Any, Any], tuple[Any, Any]], dict[str, Any], dict[str, Any]]] = {
    "each by the other": (lambda p, v, u: (u - 0.3 * v, 0.8 * p), {}, {}),
    "each by itself": (lambda p, v, u: (u - 0.3 * p, 0.8 * v), {}, {}),
    "limits above": (lambda p, v, u: (v, u - 0.3 * v), {"max": 0.6}, {"max": 2.5}),
    "limits below": (lambda p, v, u: (v, u - 0.3 * v), {"min": 0.1}, {"min": -0.5}),
}


def test_states_and_limits_of_other_roles_are_not_mixed_up() -> None:
    """One after the other in one process: dynamics beside SciPy, limits at all points."""
    for rates, of_speed, of_control in ROLES.values():
        p, v, u = tx.State("p"), tx.State("v", **of_speed), tx.Control("u", **of_control)
        result = Problem(
            tx.compile(tx.System(rates=dict(zip((p, v), rates(p, v, u))))),
            tx.Minimize(running=u * u + 0.2 * (p + v) ** 2),
            nodes=9,
            final_time=3.0,
            initial={p: 0.0, v: 0.3},
            final={p: 1.5},
        ).solve()
        assert result.solved
        found = np.stack([result.xs["p"], result.xs["v"]], axis=1)
        for k, control in enumerate(result.us["u"]):
            rolled = solve_ivp(lambda t, x, c=control, f=rates: f(*x, c), (0.0, 3.0 / 8), found[k], rtol=1e-8)
            np.testing.assert_allclose(found[k + 1], rolled.y[:, -1], atol=1e-3)
        for own, values in ((of_speed, result.xs["v"]), (of_control, result.us["u"])):
            assert values.max() <= own.get("max", np.inf) + 1e-6
            assert values.min() >= own.get("min", -np.inf) - 1e-6


#: As users start: in single precision, with nothing compiled before.
FIRST = """
import twistax as tx

p, v, u = tx.State("p"), tx.State("v"), tx.Control("u")
dynamics = tx.compile(tx.System(rates={p: v, v: u - 0.1 * tx.Sin(p)}))
ends = {"initial": {p: 0.0, v: 0.0}, "final": {p: 1.0, v: 0.0}}
result = tx.trajectory.Problem(dynamics, tx.Minimize(running=u * u), nodes=5, final_time=2.0, **ends).solve()
print(result.status.name, result.xs["p"].dtype)
"""


def test_the_first_solve_of_a_process_in_single_precision() -> None:
    """Threads that make machine code have settings of JAX of their own."""
    env = {**os.environ, "TWISTAX_CACHE": "off", "JAX_ENABLE_X64": "0"}
    done = subprocess.run([sys.executable, "-c", FIRST], env=env, capture_output=True, text=True, timeout=120)
    assert done.stdout.split() == ["SOLVED", "float64"], done.stderr
