"""Every derivative the optimiser sees against finite differences, on a problem that has every kind of row."""

import jax
import numpy as np
import pytest
from trajectory_systems import quick_jit

import twistax as tx
from twistax.trajectory import Problem
from twistax.trajectory.transcription import Evaluation, Iterate

NODES = 4


def rich_problem() -> Problem:
    """A ball under torque and a push that changes with time; limits on states, on controls and on both."""
    R, w = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,), max=[1.5, None, 2.0])
    u, t = tx.Control("u", shape=(3,), min=-1.0), tx.Time()
    system = tx.System(
        rates={R: w, w: u + tx.Sin(3.0 * t) * R[:, 0] - tx.linalg.Cross(w, np.array([1.0, 2.0, 3.0]) * w)},
        constraints={
            "spin": tx.linalg.Norm(w) <= 2.0,
            "power": u @ w <= 1.0 + t,
            "torque": u @ u <= 4.0,
            "level": R[2, 0] * t == 0.1,
        },
    )
    return Problem(
        tx.compile(system),
        tx.Minimize(t**2 + w[0] ** 2 + R[0, 1], running=(1.0 + t) * (u @ u) + w @ w),
        nodes=NODES,
        final_time=(0.5, 3.0),
        initial={"R": np.eye(3)},
        final=[w[1] <= 0.3, R[0, 2] == 0.0],
    )


@pytest.fixture(scope="module")
def evaluated() -> tuple[Problem, Iterate, np.ndarray, list[Evaluation]]:
    """Evaluations at an iterate and after small steps there and back in some directions."""
    problem, rng = rich_problem(), np.random.default_rng(0)
    size = NODES * problem.transcription.block + 1
    xs = {
        "R": np.asarray(jax.vmap(tx.SO3.exp)(rng.normal(size=(NODES, 3)))),
        "w": rng.normal(size=(NODES, 3)),
    }
    iterate = Iterate(xs, rng.normal(size=(NODES - 1, 3)), np.asarray(1.3))
    directions = rng.normal(size=(6, size))
    steps = np.concatenate([np.zeros((1, size)), *(e * directions for e in (5e-4, -5e-4, 1e-3, -1e-3))])
    evaluate = quick_jit(lambda step: problem.transcription.evaluate(iterate, step, {}))
    return problem, iterate, directions, [jax.tree.map(np.asarray, evaluate(step)) for step in steps]


def richardson(values: list[np.ndarray]) -> np.ndarray:
    """Derivatives along the directions from the values after the steps."""
    near_plus, near_minus, far_plus, far_minus = np.array(values[1:]).reshape(4, 6, *np.shape(values[0]))
    return (4.0 * (near_plus - near_minus) / 1e-3 - (far_plus - far_minus) / 2e-3) / 3.0


def seen(problem: Problem, direction: np.ndarray) -> np.ndarray:
    """What every interval sees of a direction."""
    block = problem.transcription.block
    return np.array([[*direction[k * block : (k + 2) * block], direction[-1]] for k in range(NODES - 1)])


def test_slopes_of_all_rows(evaluated: tuple) -> None:
    problem, _, directions, found = evaluated
    names = problem.transcription.names
    expected = richardson([e.rows for e in found])
    slopes = np.array([np.einsum("krl,kl->kr", found[0].slopes, seen(problem, d)) for d in directions])
    np.testing.assert_allclose(slopes, expected, atol=1e-7)
    for name in ("spin", "power", "torque", "level", "w[2] <= 2", "u[0] >= -1", "final time <= 3"):
        assert name in names
    assert sum(name.startswith("final: ") for name in names) == 2


def test_the_gradient_of_the_objective(evaluated: tuple) -> None:
    problem, _, directions, found = evaluated
    expected = richardson([e.cost for e in found])
    slopes = [(found[0].gradient * seen(problem, d)).sum() for d in directions]
    np.testing.assert_allclose(slopes, expected, atol=1e-7)


def test_the_curvature_is_symmetric_and_never_negative(evaluated: tuple) -> None:
    bends = evaluated[3][0].curvature
    np.testing.assert_allclose(bends, bends.transpose(0, 2, 1), atol=1e-12)
    assert np.linalg.eigvalsh(bends).min() > -1e-10
    assert np.abs(bends).max() > 1.0


def test_the_final_cost_bends_as_it_should(evaluated: tuple) -> None:
    """t^2 + w_0^2 + R_01: the first two have curvature 2 in T and w_0, on top of the running cost's share."""
    problem, iterate, _, found = evaluated
    t = problem.transcription
    running_only = Problem(
        problem.dynamics,
        tx.Minimize(running=problem.objective.running),
        nodes=NODES,
        final_time=(0.5, 3.0),
        initial={"R": np.eye(3)},
    ).transcription
    zero = np.zeros(NODES * t.block + 1)
    without = np.asarray(quick_jit(lambda z: running_only.evaluate(iterate, z, {}).curvature)(zero))
    extra = (found[0].curvature - without)[-1]
    assert extra[-1, -1] == pytest.approx(2.0)
    assert extra[t.block + 3, t.block + 3] == pytest.approx(2.0)
    # R_01 = e_0' R e_1 has second derivatives of both signs; only the positive part stays.
    assert np.linalg.eigvalsh(extra).min() > -1e-10


def test_rows_are_asked_where_they_matter(evaluated: tuple) -> None:
    t = evaluated[0].transcription
    asked = {name: [] for name in t.names}
    for row, name in enumerate(t.names):
        asked[name] += [t.place(int(k), row) for k in np.flatnonzero(t.exists[:, row])]
    assert asked["torque"] == ["at node 0", "at node 1", "at node 2"]
    points = ["at node 0", "at node 1", "at node 2", "between nodes 0 and 1", "between nodes 1 and 2"]
    assert sorted(asked["spin"]) == sorted([*points, "between nodes 2 and 3", "at node 3"])
    # With its own control a shared node is asked from both sides.
    assert asked["power"].count("at node 1") == 2
    assert asked["dynamics of R"][0] == "between nodes 0 and 1"


@pytest.mark.parametrize(("substeps", "power"), [(1, 1), (3, 1), (2, 3), (4, 3)])
def test_the_running_cost_is_exact_for_polynomials(substeps: int, power: int) -> None:
    """Cubic ones by Simpson's rule, linear ones where the number of substeps is odd."""
    x, u = tx.State("x"), tx.Control("u")
    objective = tx.Minimize(running=tx.Time() ** power)
    problem = Problem(
        tx.compile(tx.System(rates={x: u})), objective, nodes=3, substeps=substeps, final_time=1.3, initial={"x": 0.0}
    )
    iterate = Iterate({"x": np.zeros(3)}, np.zeros((2, 1)), np.asarray(1.3))
    found = quick_jit(problem.transcription.evaluate)(iterate, np.zeros(3 * problem.transcription.block + 1), {})
    np.testing.assert_allclose(found.cost, 1.3 ** (power + 1) / (power + 1), rtol=1e-14)
