"""`tx.repeat`: a fleet is its copies."""

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

import twistax as tx

g, V = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,), min=-9.0, initial=np.zeros(6))
F, m = tx.Control("F", shape=(6,), max=5.0), tx.Parameter("m", value=np.arange(1.0, 7.0))
BODY = tx.System(
    rates={g: V, V: (F - tx.lie.AdjointDual(V, m * V)) / m},
    outputs={"speed": tx.linalg.Norm(tx.lie.linear(V)), "pose": g},
    constraints={"above": g[2, 3] >= -1.0, "slow": tx.Soft(V[:3] <= 1.0, l1=np.ones(3))},
    labels={F: [(f"F{k}", "N") for k in range(6)]},
)
ONE = tx.compile(BODY)


def starts(count: int) -> tuple[dict[str, Any], dict[str, Any]]:
    draw = np.random.default_rng(0)
    poses = np.stack([np.asarray(tx.SE3.exp(draw.normal(size=6))) for _ in range(count)])
    return {"g": poses, "V": draw.normal(size=(count, 6))}, {"F": draw.normal(size=(count, 6))}


def of_each(function: Callable[..., Any], *arguments: Any) -> list[Any]:
    count = len(jax.tree.leaves(arguments)[0])
    return [function(*jax.tree.map(lambda a, k=k: a[k], arguments)) for k in range(count)]


@pytest.mark.parametrize("count", [1, 3])
def test_rates_outputs_and_constraints_are_those_of_each_copy(count: int) -> None:
    fleet = tx.compile(tx.repeat(BODY, count))
    x, u = starts(count)
    rates, wanted = fleet(0.0, x, u), of_each(lambda x, u: ONE(0.0, x, u), x, u)
    np.testing.assert_allclose(rates["V"], [w["V"] for w in wanted], rtol=1e-12)
    np.testing.assert_allclose(rates["g"], np.concatenate([w["g"] for w in wanted]), rtol=1e-12)
    outputs = fleet.outputs(0.0, x, u)
    assert outputs["pose"].shape == (count, 4, 4)
    np.testing.assert_allclose(outputs["speed"], np.linalg.norm(x["V"][:, :3], axis=1), rtol=1e-12)
    held = fleet.constraints(0.0, x, u)["inequality"]
    np.testing.assert_allclose(held[:count], -1.0 - x["g"][:, 2, 3], rtol=1e-12)
    np.testing.assert_allclose(held[count:], (x["V"][:, :3] - 1.0).ravel(), atol=1e-12)


def test_a_motion_is_that_of_each_copy() -> None:
    x, u = starts(3)
    run = {"t1": 0.5, "dt": 0.05}
    fleet = tx.integrate(tx.compile(tx.repeat(BODY, 3)), x, u=u, **run).last
    wanted = of_each(lambda x, u: tx.integrate(ONE, x, u=u, **run).last, x, u)
    for name in ("g", "V"):
        np.testing.assert_allclose(fleet[name], [w[name] for w in wanted], atol=1e-11)


def test_the_jacobian_has_a_block_for_each_copy() -> None:
    p, v, f = tx.State("p"), tx.State("v"), tx.Control("f")
    cart = tx.System(rates={p: v, v: f - v * v})
    x, u = {"p": np.zeros(3), "v": np.array([0.5, 1.0, 2.0])}, {"f": np.ones(3)}
    got = tx.compile(tx.repeat(cart, 3)).jacobian(0.0, x, u)
    wanted = np.zeros((6, 6))
    wanted[:3, 3:], wanted[3:, 3:] = np.eye(3), np.diag(-2.0 * x["v"])
    np.testing.assert_allclose(got["x"], wanted, atol=1e-14)


DENSE = tx.Parameter("M", value=np.diag(np.arange(1.0, 7.0)) + 0.1)
HEAVY = tx.System(rates={g: V, V: tx.linalg.Solve(DENSE, F - tx.lie.AdjointDual(V, DENSE @ V))})


def test_copies_are_a_batch_of_one_kernel() -> None:
    pytest.importorskip("llvmlite")
    assert tx.compile(tx.repeat(HEAVY, 2)).explain().backend == "a batch of one kernel for all copies"


def test_values_derivatives_and_files_of_a_batch_of_copies(tmp_path: Path) -> None:
    pytest.importorskip("llvmlite")
    count = 40
    fleet, one = tx.compile(tx.repeat(HEAVY, count)), tx.compile(HEAVY)
    x, u = starts(count)
    assert fleet.explain().backend == "a batch of one kernel for all copies"
    wanted = of_each(lambda x, u: one(0.0, x, u)["V"], x, u)
    np.testing.assert_allclose(fleet(0.0, x, u)["V"], wanted, rtol=1e-12, atol=1e-14)

    def work(dynamics: tx.Dynamics, V: jax.Array, x: Any, u: Any) -> jax.Array:
        return (dynamics(0.0, {"g": x["g"], "V": V}, u)["V"] ** 2).sum()

    slopes = of_each(lambda x, u: jax.grad(functools.partial(work, one))(x["V"], x, u), x, u)
    np.testing.assert_allclose(jax.grad(functools.partial(work, fleet))(x["V"], x, u), slopes, rtol=1e-9, atol=1e-11)
    fleet.save(tmp_path / "fleet.txz")
    np.testing.assert_allclose(tx.load(tmp_path / "fleet.txz")(0.0, x, u)["V"], wanted, rtol=1e-12, atol=1e-14)


def test_the_program_does_not_grow_with_the_count() -> None:
    def length(count: int) -> int:
        rates = tx.lower(tx.repeat(BODY, count).rates)
        return len(jax.make_jaxpr(lambda x, u: rates(0.0, x, u))(*starts(count)).eqns)

    assert length(2) == length(50)


def test_declarations_become_those_of_all_copies() -> None:
    fleet = tx.repeat(BODY, 2, per_copy=["m"])
    assert [leaf.shape for leaf in (fleet.g, fleet.V, fleet.F, fleet.m)] == [(2, 4, 4), (2, 6), (2, 6), (2, 6)]
    np.testing.assert_array_equal(fleet.V.min, np.full((2, 6), -9.0))
    np.testing.assert_array_equal(fleet.F.max, np.full((2, 6), 5.0))
    np.testing.assert_array_equal(fleet.V.initial, np.zeros((2, 6)))
    assert fleet.labels["F"][7] == ("F1 1", "N")
    x, u = starts(2)
    heavy = np.stack([m.value, 2.0 * m.value])
    got = tx.compile(fleet)(0.0, x, u, {"m": heavy})["V"]
    wanted = of_each(lambda x, u, m: ONE(0.0, x, u, {"m": m})["V"], x, u, heavy)
    np.testing.assert_allclose(got, wanted, rtol=1e-12)
    common = tx.repeat(BODY, 2, shared=["F"])
    assert common.F.shape == (6,)
    rates = tx.compile(common)(0.0, x, {"F": u["F"][0]})["V"]
    np.testing.assert_allclose(rates[1], ONE(0.0, {k: a[1] for k, a in x.items()}, {"F": u["F"][0]})["V"], rtol=1e-12)


def test_a_fleet_is_joined_and_planned() -> None:
    p, v, f = tx.State("p"), tx.State("v"), tx.Control("f")
    fleet = tx.repeat(tx.System(rates={p: v, v: f}), 2)
    push = tx.Control("push")
    pair = tx.join(fleet, connect={fleet.f: tx.Stack([push - fleet.p[0] + fleet.p[1], fleet.p[0] - fleet.p[1]])})
    result = tx.trajectory.Problem(
        tx.compile(pair),
        tx.Minimize(running=push**2),
        nodes=9,
        final_time=3.0,
        initial={"p": np.zeros(2), "v": np.zeros(2)},
        final={"p": np.ones(2), "v": np.zeros(2)},
    ).solve()
    assert result.status is tx.trajectory.Status.SOLVED
    np.testing.assert_allclose(result.xs["p"][-1], np.ones(2), atol=1e-6)


@pytest.mark.parametrize(
    ("build", "match"),
    [
        (lambda: tx.repeat(BODY, 0), "count"),
        (lambda: tx.repeat(BODY, 2, per_copy=["F"]), "per_copy names 'F'"),
        (lambda: tx.repeat(BODY, 2, shared=["m"]), "shared names 'm'"),
        (lambda: tx.repeat(3.0, 2), "expects a System, got 3.0"),
    ],
)
def test_errors(build: Callable[[], Any], match: str) -> None:
    with pytest.raises(tx.ModelError, match=match):
        build()
