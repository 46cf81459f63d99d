"""Scalar programs under JAX's transformations, alone and inside compiled systems."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from test_scalar_control import scaled_back, tilted

import twistax as tx
from transformations import agree, transformed
from twistax.scalar.jax_primitive import Derived, call_program
from twistax.scalar.reader import scalarize
from twistax.scenes import SCENES

RNG = np.random.default_rng(0)
X, A = RNG.normal(size=3), RNG.normal(size=(3, 3)) + 3.0 * np.eye(3)
XS, AS = RNG.normal(size=(4, 3)), RNG.normal(size=(4, 3, 3)) + 3.0 * np.eye(3)


def solved(x: jax.Array, a: jax.Array) -> jax.Array:
    """A solve, an own derivative, a branch and a place known only at run time."""
    y = jnp.linalg.solve(a, tilted(x)) + x / (2.0 + x[0] ** 2)
    y = lax.cond(x[1] > 0.0, lambda v: v * jnp.sqrt(jnp.abs(x[1])), jnp.cos, y)
    return y * x[jnp.argmax(x)]


def looped(x: jax.Array, a: jax.Array) -> jax.Array:
    """A loop written out, a library call."""
    end, rows = lax.scan(lambda c, row: (jnp.tanh(row @ c) + 0.1 * c, c.sum()), x, jnp.stack([a, a.T]))
    return end + jnp.sort(rows)[0] * x


@pytest.mark.parametrize("function", [pytest.param(solved, marks=pytest.mark.slow), looped])
def test_under_transformations(function: Callable[..., jax.Array]) -> None:
    programs = {}

    def as_scalars(x: jax.Array, a: jax.Array) -> jax.Array:
        shapes = jax.ShapeDtypeStruct((3,), x.dtype), jax.ShapeDtypeStruct((3, 3), x.dtype)
        if x.dtype not in programs:
            programs[x.dtype] = Derived(scalarize(lambda *v: [function(*v)], *shapes))
        return call_program(programs[x.dtype], x, a)[0]

    both = jax.jit(
        lambda *arguments: [transformed(f)(*arguments) for f in (as_scalars, function)],
        compiler_options={"xla_backend_optimization_level": 0},
    )
    agree(*both(X, A, XS, AS))


def test_reverse_only_functions() -> None:
    """A function with a reverse rule alone: gradients work, also of a loop and batched; forward is refused."""

    def function(x: jax.Array) -> jax.Array:
        return scaled_back(2.0)(jnp.sin(x)) * x

    derived = Derived(scalarize(lambda x: [function(x)], jax.ShapeDtypeStruct((3,), float)))

    def every(f: Any) -> Any:
        looping = jax.grad(lambda x: lax.scan(lambda c, _: (f(c), None), x, None, length=3)[0].sum())
        return jax.grad(lambda x: f(x).sum())(X), looping(jnp.asarray(X)), jax.vmap(looping)(jnp.asarray(XS))

    agree(*jax.jit(lambda: [every(lambda x: call_program(derived, x)[0]), every(function)])())
    with pytest.raises(TypeError, match="custom_vjp"):
        jax.jvp(lambda x: call_program(derived, x)[0], (X,), (X,))


def test_odd_arguments() -> None:
    """None at all, empty ones, integers, truth values; in a batch too."""
    nothing = Derived(scalarize(lambda: [jnp.arange(3.0), jnp.sin(jnp.ones(()))]))
    np.testing.assert_allclose(call_program(nothing)[0], [0.0, 1.0, 2.0])

    def function(e: jax.Array, n: jax.Array, c: jax.Array, x: jax.Array) -> list[jax.Array]:
        return [e * 2.0, n + 1, ~c, jnp.where(c, x, n.astype(float)), jnp.zeros((0, 2), int), x]

    arguments = jnp.zeros((2, 0)), jnp.array([3, 4]), jnp.array([True, False]), jnp.array([0.5, 1.5])
    shapes = [jax.ShapeDtypeStruct(a.shape[1:], a.dtype) for a in arguments]
    derived = Derived(scalarize(function, *shapes))

    def every(f: Any) -> Any:
        slope = jax.vmap(jax.grad(lambda x, *rest: f(*rest, x)[3]))(arguments[3], *arguments[:3])
        return f(*(a[0] for a in arguments)), jax.vmap(f)(*arguments), jax.vmap(f)(*(a[:0] for a in arguments)), slope

    agree(*jax.jit(lambda: [every(lambda *a: call_program(derived, *a)), every(function)])())
    only_empty = Derived(scalarize(lambda e: [e * 2.0], jax.ShapeDtypeStruct((0,), float)))
    assert call_program(only_empty, jnp.zeros(0))[0].shape == (0,)
    assert jax.vmap(lambda e: call_program(only_empty, e)[0])(jnp.zeros((3, 0))).shape == (3, 0)


# ---- compiled systems ------------------------------------------------------------------------------------------------

w, mass, R = tx.State("w", (3,)), tx.State("mass"), tx.State("R", group=tx.SO3)
J, F = tx.Parameter("J", value=np.diag([1.0, 2.0, 3.0])), tx.Control("F", (3,))
BODY = tx.System(
    rates={w: tx.linalg.Solve(J, F - tx.linalg.Cross(w, J @ w)), R: w, mass: -tx.linalg.Norm(F)},
    controls=[F],
    parameters=[J],
)
SCALARS, ARRAYS = tx.compile(BODY, backend=tx.XLA(least=0)), tx.compile(BODY, backend=tx.JAX())
START = {"w": np.array([0.4, -0.5, 0.6]), "R": np.eye(3), "mass": np.float64(4.0)}
U = {"F": np.array([0.1, -0.2, 0.3])}


def test_compiled_systems() -> None:
    """Rates and their derivatives by state, control and parameter, single and batched."""
    spread = np.array(J.value) + 0.1 * RNG.normal(size=(3, 3))

    def every(dynamics: tx.Dynamics) -> Any:
        def rates(v: Any, force: Any, inertia: Any) -> Any:
            return dynamics(0.0, START | {"w": v}, {"F": force}, {"J": inertia})

        def total(*a: Any) -> Any:
            return sum(jnp.sum(jnp.cos(r)) for r in rates(*a).values())

        arguments = jnp.asarray(START["w"]), jnp.asarray(U["F"]), jnp.asarray(spread)
        batch = [a[None] * jnp.linspace(0.5, 1.5, 3).reshape((3,) + (1,) * a.ndim) for a in arguments]
        return {
            "rates": rates(*arguments),
            "jacfwd": jax.jacfwd(rates, (0, 1))(*arguments),
            "grad": jax.grad(total, (0, 1, 2))(*arguments),
            "vmap of grad": jax.vmap(jax.grad(total, 2))(*batch),
        }

    agree(*jax.jit(lambda: [every(SCALARS), every(ARRAYS)], compiler_options={"xla_backend_optimization_level": 0})())


def end(dynamics: tx.Dynamics, v: Any, **how: Any) -> Any:
    return tx.integrate(dynamics, START | {"w": v}, t1=0.5, u=U, throw=False, **how).xs


@pytest.mark.slow
def test_a_flight_and_its_gradient() -> None:
    def every(dynamics: tx.Dynamics) -> Any:
        return jax.value_and_grad(lambda v: end(dynamics, v, dt=0.1)["R"][..., 0, 1].sum())(jnp.asarray(START["w"]))

    agree(every(SCALARS), every(ARRAYS))


@pytest.mark.slow
def test_adaptive_flights_in_a_batch() -> None:
    def every(dynamics: tx.Dynamics) -> Any:
        return jax.vmap(lambda s: end(dynamics, s * START["w"], rtol=1e-8, atol=1e-8))(jnp.array([0.5, 1.0]))

    agree(every(SCALARS), every(ARRAYS))


@pytest.mark.parametrize("name", ["heavy-top", "rocket", "offset-tumble", "stiff-attitude"])
def test_jacobian_of_scenes(name: str) -> None:
    """As forward differentiation through a retraction; what the pattern leaves out is exactly zero there."""
    scene = SCENES[name]
    dynamics = scene.dynamics
    controls = {c.name: RNG.normal(size=c.shape) for c in dynamics.controls}
    params = {p.name: jnp.asarray(scene.params.get(p.name, p.value)) for p in dynamics.parameters}
    wrt = ("x", *(["u"] if controls else []), *(["params"] if params else []))

    def rates(x: Any, u: Any, p: Any) -> jax.Array:
        found = dynamics.functions.evaluate("rates", jnp.asarray(0.3), x, u, p)
        return jnp.concatenate([found[s.name].reshape(-1) for s in dynamics.states])

    def dense(x: Any) -> dict[str, jax.Array]:
        wide = dynamics.dimension

        def flat(derivative: Any, order: Any) -> jax.Array:
            rows = [derivative[leaf.name].reshape(wide, -1) for leaf in order if leaf.name in derivative]
            return jnp.concatenate(rows, axis=1) if rows else jnp.zeros((wide, 0))

        found = {"x": jax.jacfwd(lambda d: rates(dynamics.retract(x, d), controls, params))(jnp.zeros(wide))}
        if params:
            found["params"] = flat(jax.jacfwd(rates, 2)(x, controls, params), dynamics.parameters)
        if controls:
            found["u"] = flat(jax.jacfwd(rates, 1)(x, controls, params), dynamics.controls)
        return found

    d = 0.3 * RNG.normal(size=dynamics.dimension)
    start = {k: jnp.asarray(v) for k, v in scene.start.items()}
    at = {k: jnp.asarray(v) for k, v in dynamics.retract(start, d).items()}
    found = jax.jit(lambda x: dynamics.jacobian(0.3, x, controls, params, wrt=wrt))(at)
    expected = jax.jit(dense, compiler_options={"xla_backend_optimization_level": 0})(at)
    assert set(found) == set(wrt)
    functions = dynamics.functions
    program, _ = functions.rate_jacobian(functions.prepare(0.3, at, controls, params), tuple(wrt))
    for kind, block in found.items():
        other = np.asarray(expected[kind])
        np.testing.assert_allclose(block, other, rtol=0.0, atol=1e-11 * max(1.0, np.abs(other).max(initial=0.0)))
        assert program.pattern[kind].shape == other.shape
        assert not other[~program.pattern[kind]].any()
    assert not program.pattern["x"].all()
