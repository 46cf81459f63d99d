"""States on groups of users' own: what takes poses takes them. The truth is SciPy's exponential, and differences."""

import csv
import functools
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm

import twistax as tx
from registered import concrete_classes
from twistax.groups import ElementPart, Group
from twistax.integrators import Method
from users_groups import SE2, SIM2, SO2, Similarity

GROUPS: list[Group] = [SO2(), SE2, SIM2]
by_group = pytest.mark.parametrize("group", GROUPS, ids=lambda group: group.name)
XI = np.array([0.3, -0.2, 0.7, 0.1])


def velocity(group: Group) -> np.ndarray:
    return XI[2:3] if group.dimension == 1 else XI[: group.dimension]


def hat(group: Group, d: np.ndarray) -> np.ndarray:
    """The matrix of a tangent, written out."""
    if isinstance(group, SO2):
        return np.array([[0.0, -d[0]], [d[0], 0.0]])
    s = d[3] if len(d) == 4 else 0.0
    return np.array([[s, -d[2], d[0]], [d[2], s, d[1]], [0.0, 0.0, 0.0]])


def at(group: Group, t: float) -> np.ndarray:
    """The element after t of a motion with that velocity."""
    return expm((0.5 + t) * hat(group, velocity(group)))


@functools.cache
def moving(group: Group) -> tx.Dynamics:
    """A state on the group, its velocity, and a force that depends on the element, all of it used below."""
    n = group.dimension
    q, w, u = tx.State("q", group=group), tx.State("w", shape=(n,)), tx.Control("u", shape=(n,), min=-9.0, max=9.0)
    pull = tx.Parameter("pull", value=0.0)
    return tx.compile(tx.System(rates={q: w, w: u - pull * q[0, 1] * np.ones(n)}, outputs={"e": q[0, 0]}))


def arguments(group: Group) -> tuple[dict[str, Any], dict[str, Any]]:
    return {"q": at(group, 0.0), "w": velocity(group)}, {"u": np.zeros(group.dimension)}


@by_group
def test_a_state_is_declared_with_a_start_and_refuses_what_is_no_element(group: Group) -> None:
    assert (tx.State("q", group=group, initial=at(group, 0.0)).initial == at(group, 0.0)).all()
    off = at(group, 0.0) + 0.01 * np.arange(at(group, 0.0).size).reshape(group.shape)
    with pytest.raises(tx.ModelError, match=rf"(?s)initial is not an element of {group.name} .*normalize"):
        tx.State("q", group=group, initial=off)
    x, u = arguments(group)
    with pytest.raises(tx.InputError, match=rf"(?s)not an element of {group.name}: off by .*normalize of the group"):
        tx.integrate(moving(group), {**x, "q": off}, t1=1.0, dt=0.1, u=u)


METHODS: list[Method] = [
    tx.RKMK(tx.tableaus.RK4),
    tx.ImplicitRKMK(tx.tableaus.GAUSS_LEGENDRE4),
    tx.CommutatorFree(),
    tx.Magnus(),
]

#: Methods without a case here: of rigid bodies, which users' groups are not; of another class, with corrections.
WITHOUT = {"Splitting", "Projected"}


def test_no_method_is_forgotten() -> None:
    names = {type(method).__name__ for method in METHODS}
    assert names | WITHOUT == {cls.__name__ for cls in concrete_classes(Method)}


@pytest.mark.parametrize("method", METHODS, ids=lambda method: type(method).__name__)
def test_every_method_moves_along_the_group(method: Method) -> None:
    q, w = tx.State("q", group=SIM2), tx.State("w", shape=(4,))
    steady = tx.compile(tx.System(rates={q: w, w: np.zeros(4)}))  # as Magnus needs them
    end = tx.integrate(steady, arguments(SIM2)[0], t1=2.0, dt=0.1, method=method).last["q"]
    np.testing.assert_allclose(end, at(SIM2, 2.0), atol=1e-12)


@by_group
def test_steps_of_both_kinds_between_steps_and_their_derivative(group: Group) -> None:
    x, u = arguments(group)
    ts = np.array([0.111, 0.9, 2.0])
    truth = np.stack([at(group, t) for t in ts])
    fixed = tx.integrate(moving(group), x, t1=2.0, dt=0.05, u=u, save_at=ts)
    np.testing.assert_allclose(fixed.xs["q"], truth, atol=1e-12)
    atol = {"q": np.full(group.dimension, 1e-9), "w": 1e-9}
    adaptive = tx.integrate(moving(group), x, t1=2.0, rtol=1e-9, atol=atol, u=u, save_at=ts)
    np.testing.assert_allclose(adaptive.xs["q"], truth, atol=1e-9)
    ends = lambda w: tx.integrate(moving(group), {**x, "w": w}, t1=2.0, dt=0.05, u=u).last["q"]  # noqa: E731
    step = 1e-6
    units = np.eye(group.dimension)
    slope = np.stack([(ends(x["w"] + step * e) - ends(x["w"] - step * e)) / (2 * step) for e in units], -1)
    np.testing.assert_allclose(jax.jacfwd(ends)(jnp.asarray(x["w"])), slope, atol=1e-8)


def test_lengths_are_measured_by_the_position() -> None:
    """A tolerance is relative to how far away a group with a position is; a pair is (rotation, position)."""
    x, u = arguments(SE2)
    far = {**x, "q": x["q"] + 1e6 * np.array([[0, 0, 1.0], [0, 0, 1.0], [0, 0, 0]])}
    assert (np.asarray(SE2.sizes(jnp.asarray(far["q"])))[[0, 1]] > 1e6).all()
    assert SE2.sizes(jnp.asarray(far["q"]))[2] == 1.0
    tight = tx.integrate(moving(SE2), x, t1=2.0, rtol=1e-9, atol={"q": (1e-9, 1e-3), "w": 1e-9}, u=u)
    np.testing.assert_allclose(tight.last["q"], at(SE2, 2.0), atol=1e-8)


@by_group
def test_derivatives_of_the_dynamics(group: Group) -> None:
    (x, u), n, params = arguments(group), group.dimension, {"pull": 2.0}

    def rates(d: Any) -> Any:
        moved = {"q": group.retract(jnp.asarray(x["q"]), d[:n]), "w": x["w"] + d[n:]}
        found = moving(group)(0.0, moved, u, params)
        return jnp.concatenate([found["q"], found["w"]])

    zero, step = jnp.zeros(2 * n), 1e-6
    slope = np.stack([(rates(step * e) - rates(-step * e)) / (2 * step) for e in np.eye(2 * n)], axis=1)
    np.testing.assert_allclose(moving(group).jacobian(0.0, x, u, params)["x"], slope, atol=1e-8)
    hessian = moving(group).hessian(0.0, x, u, params, {"w": np.ones(n)}, wrt="x")
    np.testing.assert_allclose(hessian, jax.hessian(lambda d: rates(d)[n:].sum())(zero), atol=1e-12)
    np.testing.assert_allclose(tx.trajectory.linearize(moving(group), 0.0, x, u, params).A[n:], slope[n:], atol=1e-8)


def test_tables_and_plots_show_the_parts(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib").use("Agg")
    heads = {}
    for group in GROUPS:
        x, u = arguments(group)
        solution = tx.integrate(moving(group), x, t1=1.0, dt=0.1, u=u, save_at=np.linspace(0.0, 1.0, 4))
        solution.to_csv(tmp_path / "table.csv")
        rows = list(csv.reader((tmp_path / "table.csv").read_text().splitlines()))
        heads[group.name] = [head for head in rows[0] if head.startswith("q")]
        assert solution.plot().axes
        entries = dict(zip(rows[0], map(float, rows[-1]), strict=True))
        first = at(group, 1.0)[(0, 0) if group == SO2() else (0, 2)]
        assert entries[heads[group.name][0]] == pytest.approx(first, abs=1e-12)
    assert heads["SO2"] == ["q[0][0]", "q[0][1]", "q[1][0]", "q[1][1]"]
    assert heads["SE2"] == ["q.x", "q.y", *(f"q.heading[{i}][{j}]" for i in "01" for j in "01")]
    assert heads["Sim2"] == ["q.x", "q.y", *(f"q.shape[{i}][{j}]" for i in "01" for j in "01")]


@by_group
def test_files_give_the_group_again_and_c_code_says_it(group: Group, tmp_path: Path) -> None:
    x, u = arguments(group)
    moving(group).save(tmp_path / "saved")
    again = tx.load(tmp_path / "saved")
    assert again.group == moving(group).group
    assert (again(0.0, x, u)["q"] == moving(group)(0.0, x, u)["q"]).all()
    moving(group).to_c(tmp_path)
    assert f"an element of {group.name}" in (tmp_path / "dynamics.h").read_text()


def test_diffrax_solves_on_the_group_and_beside_it() -> None:
    diffrax = pytest.importorskip("diffrax")
    x, u = arguments(SE2)
    x = jax.tree.map(jnp.asarray, x)
    solver, term = tx.diffrax.LieSolver(diffrax.Tsit5(), moving(SE2)), tx.diffrax.lie_term(moving(SE2))
    control = tx.diffrax.controller(rtol=1e-9, atol=1e-9)
    on = diffrax.diffeqsolve(term, solver, 0.0, 2.0, 0.01, x, args=(u, None), stepsize_controller=control)
    np.testing.assert_allclose(on.ys["q"][-1], at(SE2, 2.0), atol=1e-8)
    plain = tx.diffrax.ambient_term(moving(SE2))
    beside = diffrax.diffeqsolve(plain, diffrax.Tsit5(), 0.0, 2.0, 0.01, x, args=(u, None))
    np.testing.assert_allclose(beside.ys["q"][-1], at(SE2, 2.0), atol=1e-8)


@pytest.mark.parametrize("free", [None, "position", "heading"])
def test_a_problem_ends_where_it_must_and_may_leave_a_part_free(free: str | None) -> None:
    final = at(SE2, 2.0)
    for part in SE2.parts:
        if part.name == free:
            final[part.place] = np.nan
    x, _ = arguments(SE2)
    still, work = np.zeros(3), tx.Control("u", shape=(3,))
    problem = tx.trajectory.Problem(
        moving(SE2),
        tx.Minimize(running=work @ work),
        nodes=7,
        final_time=2.0,
        initial={"q": x["q"], "w": still},
        final={"q": final, "w": still},
    )
    result = problem.solve()
    assert result.status is tx.trajectory.Status.SOLVED
    known = ~np.isnan(final)
    np.testing.assert_allclose(np.asarray(result.xs["q"][-1])[known], final[known], atol=1e-7)
    assert free is None or np.abs(np.asarray(result.xs["q"][-1]) - at(SE2, 2.0))[~known].max() > 1e-2
    assert set(result.replay().misses["q"]) == {"position", "angle"}


@pytest.mark.usefixtures("unchecked")
def test_what_has_no_meaning_on_the_group_is_refused() -> None:
    q = tx.State("q", group=SE2)
    for build in (tx.lie.Inverse, tx.lie.SO3Log, lambda g: tx.lie.Compose(np.eye(3), g), tx.lie.SO3Adjoint):
        with pytest.raises(tx.ModelError, match="a rotation or a pose, state q is on SE2"):
            build(q)
    assert not q.is_group_element
    half = at(SE2, 0.0)
    half[0, 0] = np.nan
    with pytest.raises(tx.ModelError, match="the whole position or the whole heading free, no other entries"):
        tx.State("q", group=SE2, final=half)

    class Changeable(Similarity):
        __hash__ = None  # type: ignore[assignment]

    with pytest.raises(tx.ModelError, match=r"(?s)comparable and hashable.*frozen dataclass"):
        tx.State("q", group=Changeable())


def test_parts_say_what_is_an_angle() -> None:
    assert [list(group.angular) for group in GROUPS[:2]] == [[False], [False, False, True]]
    assert list(tx.SE3.angular) == [False] * 3 + [True] * 3
    assert list(tx.SE3.with_order(tx.ANGULAR_FIRST).sized) == [False] * 3 + [True] * 3
    assert ElementPart("velocity", np.s_[:3, 4], (3, 4, 5), "m/s").sized
