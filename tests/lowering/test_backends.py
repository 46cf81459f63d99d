"""Whichever backend runs a system: the same numbers to rounding, in every use, and no warning."""

import functools
import importlib.util
import warnings
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import twistax as tx
from twistax.expr import Example, Expr
from twistax.mechanics import Chain, chain_models, forward_dynamics

RNG = np.random.default_rng(0)
#: Methods of few stages compile quickly; what runs their rates is the same for all.
SHORT, PAIR = tx.RKMK(tx.tableaus.HEUN), tx.RKMK(tx.tableaus.BOGACKI_SHAMPINE3)


@functools.cache
def case(name: str) -> tuple[tx.System, dict[str, Any], dict[str, Any]]:
    """A system, a state and controls."""
    if name == "free body":
        g, V = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,))
        F, M = (
            tx.Control("F", shape=(6,)),
            tx.Parameter("M", shape=(6, 6), value=np.diag([2.0, 2.0, 2.0, 0.1, 0.2, 0.3])),
        )
        system = tx.System(rates={g: V, V: tx.linalg.Solve(M, F - tx.lie.AdjointDual(V, M @ V))})
        return system, {"g": np.asarray(tx.lie.se3.exp(RNG.normal(size=6))), "V": RNG.normal(size=6)}, {"F": np.ones(6)}
    if name == "arm":  # four joints: enough operations to become scalars
        arm = Chain(chain_models.panda().links[:4])
        q, qd, tau = tx.State("q", shape=(4,)), tx.State("qd", shape=(4,)), tx.Control("tau", shape=(4,))
        system = tx.System(rates={q: qd, qd: forward_dynamics(arm, q, qd, tau)})
        return system, {"q": RNG.normal(size=4), "qd": RNG.normal(size=4)}, {"tau": RNG.normal(size=4)}
    x, u, t = tx.State("x", shape=(3,)), tx.Control("u"), tx.Time()
    drag = tx.Linterp(x[0], [-1.0, 0.0, 0.5, 2.0], [0.3, 0.1, 0.2, 0.9])
    pushed = tx.Cond(x[1] >= 0.2, u * tx.Sin(x), tx.Cos(t) * x)
    system = tx.System(
        rates={x: tx.Where(x >= 0.0, -drag * x, x**2) + pushed},
        outputs={"drag": drag},
        constraints=[tx.linalg.Norm(x) <= 3.0],
    )
    return system, {"x": np.array([0.3, 0.7, -0.4])}, {"u": np.array(1.5)}


def results(dynamics: tx.Dynamics, x: dict[str, Any], u: dict[str, Any]) -> dict[str, Any]:
    """What is asked of a system, compiled as one function."""

    def everything(x: dict[str, Any], u: dict[str, Any]) -> dict[str, Any]:
        def total(x: dict[str, Any], u: dict[str, Any]) -> jax.Array:
            return sum((jnp.sin(rate).sum() for rate in dynamics(0.2, x, u).values()), jnp.zeros(()))

        def end(u: dict[str, Any], **steps: Any) -> jax.Array:
            found = tx.integrate(dynamics, x, t0=0.0, t1=0.05, u=u, throw=False, **steps).xs
            return jnp.concatenate([value.reshape(-1) for value in found.values()])

        batch = {name: jnp.stack([0.5 * value, value, 2.0 * value]) for name, value in u.items()}
        found = {
            "rates": dynamics(0.2, x, u),
            "outputs": dynamics.outputs(0.2, x, u),
            "constraints": dynamics.constraints(0.2, x, u),
            "grad": jax.grad(total, (0, 1))(x, u),
            "vmap": jax.vmap(lambda u: dynamics(0.2, x, u))(batch),
            "fixed steps": end(u, dt=0.025, method=SHORT),
        }
        if "qd" not in x:  # what takes long to compile, of small systems alone
            found |= {
                "jacobian": dynamics.jacobian(0.2, x, u),
                "chosen steps": end(u, rtol=1e-6, atol=1e-6, method=PAIR),
            }
        if x.keys() == {"x"}:
            found["gradient of steps"] = jax.grad(lambda u: end(u, dt=0.025, method=SHORT).sum())(u)
        return found

    return jax.jit(everything, compiler_options={"xla_backend_optimization_level": 0})(x, u)


@functools.cache
def as_written(name: str) -> dict[str, Any]:
    system, x, u = case(name)
    return results(tx.compile(system, backend=tx.JAX()), x, u)


NATIVE = tx.Native(least=0)


@pytest.mark.parametrize(
    ("backend", "name"),
    [
        ("auto", "tables and conditions"),
        ("auto without llvmlite", "free body"),
        (NATIVE, "arm"),
        (NATIVE, "free body"),
        (NATIVE, "tables and conditions"),
        # Each of the three systems and each of the three backends stands above.
        pytest.param("auto", "arm", marks=pytest.mark.slow),
        pytest.param("auto", "free body", marks=pytest.mark.slow),
        pytest.param("auto without llvmlite", "arm", marks=pytest.mark.slow),
        pytest.param("auto without llvmlite", "tables and conditions", marks=pytest.mark.slow),
    ],
    ids=str,
)
def test_the_same_numbers_to_rounding(backend: Any, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    find = importlib.util.find_spec
    if backend == "auto without llvmlite":  # then all is as with tx.XLA()
        backend = "auto"
        monkeypatch.setattr(importlib.util, "find_spec", lambda of, *a: None if of == "llvmlite" else find(of, *a))
    elif find("llvmlite") is None:
        pytest.skip("native kernels need llvmlite")
    system, x, u = case(name)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = results(tx.compile(system, backend=backend), x, u)
    expected = as_written(name)
    assert jax.tree.structure(found) == jax.tree.structure(expected)
    for (path, own), other in zip(jax.tree.leaves_with_path(found), jax.tree.leaves(expected), strict=True):
        assert (own.shape, own.dtype) == (other.shape, other.dtype), path
        size = max(1.0, float(np.abs(other).max(initial=0.0)))
        np.testing.assert_allclose(own, other, rtol=0.0, atol=1e-11 * size, err_msg=str(path))


# ---- choosing one ----------------------------------------------------------------------------------------------------


def test_the_backend_is_shown() -> None:
    system, *_ = case("free body")
    head = "Dynamics(states: g SE3, V (6,); controls: F (6,); parameters: M (6, 6); backend: "
    assert repr(tx.compile(system, backend=tx.JAX())) == head + "JAX)"
    assert repr(tx.compile(system, backend=tx.XLA(checked=True))) == head + "XLA(checked=True))"
    assert repr(tx.compile(system, backend=tx.Native(threads=2))).startswith(head + "Native(threads=2) (llvmlite ")
    assert repr(tx.compile(system)).startswith(head + "auto = ")
    baked = tx.compile(tx.System(rates={tx.State("a"): 1.0}), backend=tx.XLA())
    assert repr(baked) == "Dynamics(states: a (); backend: XLA)"


# ---- what is kept ----------------------------------------------------------------------------------------------------


class Squared(Expr):
    """A A of one's own, in the precision that JAX is told to take."""

    A: tx.expr.fields.Operand

    def infer_shape(self, *shapes: Any) -> Any:
        return shapes[0]

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return values[0] @ values[0]

    @classmethod
    def example(cls) -> list[Example]:
        return []


@pytest.mark.parametrize("backend", [tx.JAX(), tx.XLA()])
def test_products_of_one_precision_are_not_served_under_another(backend: Any) -> None:
    A = tx.State("A", shape=(40, 40))
    dynamics = tx.compile(tx.System(rates={A: Squared(A)}, outputs={"y": Squared(A)}), backend=backend)

    def traced() -> str:
        functions = (lambda v: dynamics(0.0, {"A": v}), lambda v: dynamics.outputs(0.0, {"A": v}))
        return "".join(str(jax.make_jaxpr(function)(np.eye(40))) for function in functions)

    assert "HIGHEST" not in traced()
    with jax.default_matmul_precision("highest"):
        assert traced().count("HIGHEST") >= 2
    assert "HIGHEST" not in traced()


@pytest.mark.parametrize(("entries", "scalars"), [(1, True), (14, False)])
def test_wide_arrays_that_are_mostly_zeros_become_scalars(entries: int, scalars: bool) -> None:
    """Of 14 x 14 entries; where all of them matter, arrays do as well."""
    x = tx.State("x", shape=(14,))
    near = np.abs(np.subtract.outer(np.arange(14), np.arange(14))) < entries
    A = tx.Constant(14.0 * np.eye(14) + near) * (1.0 + 0.1 * tx.linalg.Outer(x, x))
    dynamics = tx.compile(tx.System(rates={x: tx.linalg.SolvePositive(A, tx.Sin(x))}), backend=tx.XLA(least=40))
    said = dynamics.explain().backend
    assert said.startswith("scalars") if scalars else "more than 128 entries" in said
    point = RNG.normal(size=14)
    full = (14.0 * np.eye(14) + near) * (1.0 + 0.1 * np.outer(point, point))
    np.testing.assert_allclose(dynamics(0.0, {"x": point})["x"], np.linalg.solve(full, np.sin(point)), rtol=1e-12)


@pytest.mark.skipif(importlib.util.find_spec("llvmlite") is None, reason="llvmlite is not installed")
def test_long_functions_are_kernels_in_loops(monkeypatch: pytest.MonkeyPatch) -> None:
    """With the numbers, and the derivatives, of the loops that XLA compiles."""
    system, x, u = case("arm")
    plain = tx.compile(system, backend=tx.XLA())
    monkeypatch.setattr("twistax.scalar.targets.llvm.backend._LONG", 100)
    kernels = tx.compile(system, backend=tx.Native())

    def end(dynamics: tx.Dynamics, rate: Any) -> Any:
        start = {**x, "qd": rate}
        return tx.integrate(dynamics, start, t1=0.1, rtol=1e-8, atol=1e-8, method=PAIR, u=u).xs["q"][-1]

    rate, moved = jnp.asarray(x["qd"]), jnp.asarray(RNG.normal(size=4))
    inside = str(jax.make_jaxpr(functools.partial(end, kernels))(rate))
    assert "native_program" in inside
    assert "scalar_program" not in inside
    found, along = jax.jvp(functools.partial(end, kernels), (rate,), (moved,))
    expected, expected_along = jax.jvp(functools.partial(end, plain), (rate,), (moved,))
    np.testing.assert_allclose(found, expected, rtol=1e-12)
    np.testing.assert_allclose(along, expected_along, rtol=1e-10)
