"""Functions with loops whose results are constants: kernels of which they are a part call them."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

pytest.importorskip("llvmlite", reason="native kernels need llvmlite")

from native_programs import at_every_width

import twistax as tx
from twistax.mechanics import ConvexPolytope, signed_distance
from twistax.scalar.kernel_function import KernelFunction
from twistax.scalar.primitives.interface import Limits, kernel_of
from twistax.scalar.reader import scalarize
from twistax.scalar.targets.llvm import kernel_body
from twistax.scalar.targets.llvm.kernel import HostKernel
from twistax.scalar.targets.llvm.kernel_body import native_form
from twistax.scalar.targets.llvm.machine_code import Processor
from twistax.scalar.targets.llvm.straight import pieces
from twistax.scalar.targets.llvm.straight.body import Straight

TURN = np.random.default_rng(0).normal(0.0, 0.3, (5, 5))


def search(x: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Iterations until a row is small, as many as the argument decides."""
    y, count = jax.lax.while_loop(
        lambda s: (jnp.max(jnp.abs(s[0])) > 0.3) & (s[1] < 50),
        lambda s: (jnp.asarray(TURN, x.dtype) @ s[0], s[1] + 1),
        (x, jnp.int32(0)),
    )
    return y, count


SEARCH = KernelFunction(search, tx.Native(), of_matrices=True, constant=True)


def function(of: Any, x: jax.Array, A: jax.Array) -> list[jax.Array]:
    """Results of two calls, one of what the other gives, before and after products of matrices and a sine."""
    y, count = of(x)
    z, _ = of(jnp.sin(x) + y)
    C = A @ (A.T @ (A * jnp.outer(z, z)))
    return [x * y + z, count * 2, C, jnp.tanh(C[0]) * x]


def test_derivatives_are_zero() -> None:
    """Alone, in batches, and as a factor, whose other factor has a derivative."""
    x = np.linspace(-2.0, 3.0, 20).reshape(4, 5)
    np.testing.assert_allclose(jax.vmap(lambda x: SEARCH(x)[0])(x), [search(row)[0] for row in x], rtol=1e-12)
    assert [int(SEARCH(row)[1]) for row in x] == [int(search(row)[1]) for row in x] != [0] * 4
    jacobian = jax.jit(jax.vmap(jax.jacfwd(lambda x: x * SEARCH(x)[0])))(x)
    np.testing.assert_allclose(jacobian, [np.diag(search(row)[0]) for row in x], rtol=1e-12)
    np.testing.assert_array_equal(jax.grad(lambda x: SEARCH(x)[0].sum())(x[0]), 0.0)


@at_every_width
@pytest.mark.parametrize("products", [False, True])
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_calls_in_pieces_and_beside_products(
    processor: Processor, products: bool, dtype: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    shapes = [jax.ShapeDtypeStruct(shape, dtype) for shape in ((5,), (5, 5))]
    limits = Limits(products=100) if products else Limits()
    form = native_form(scalarize(lambda *a: function(SEARCH, *a), *shapes, limits=limits), products=products)
    called = [kernel_of(call) is not None for call in form.calls]
    assert called.count(True) == 2
    assert called.count(False) == 2 * products
    rng = np.random.default_rng(1)
    x, A = rng.normal(size=(11, 5)).astype(dtype), rng.normal(size=(11, 5, 5)).astype(dtype)
    expected = jax.vmap(lambda *a: function(search, *a))(x, A)
    for length in (10**9, 40, 9):
        monkeypatch.setattr(Processor, "longest", length)
        monkeypatch.setattr(pieces, "_LENGTH", length)
        kernel = HostKernel(Straight(form, processor.lanes(form.dtype)), processor)
        results = kernel.run([[x, A.reshape(11, 25)][k] for k in kernel.body.read])
        for result, wanted in zip(results, expected, strict=True):
            size = 100 * np.finfo(dtype).eps * max(1.0, np.abs(wanted).max())
            np.testing.assert_allclose(result, np.asarray(wanted).reshape(11, -1), rtol=0.0, atol=size)


@pytest.mark.thorough
def test_problems_call_the_search_for_distances(monkeypatch: pytest.MonkeyPatch) -> None:
    """The kernels of a trajectory, those of first and second derivatives too, call it and not JAX."""
    T, V = tx.State("T", group=tx.SE3), tx.Control("V", shape=(6,))
    hulls = [ConvexPolytope(np.random.default_rng(k).normal(size=(5, 3))) for k in (0, 1)]
    dynamics = tx.compile(tx.System(rates={T: V}, constraints=[signed_distance(*hulls, T) >= 0.2]))
    calls, write = list[int](), kernel_body.write_call
    monkeypatch.setattr(kernel_body, "write_call", lambda *a: (calls.append(len(a)), write(*a))[1])
    start, end = (tx.pose(position=[x, 2.0, 0.3]) for x in (-5.0, 5.0))
    cost = tx.Minimize(running=V @ V)
    problem = tx.trajectory.Problem(dynamics, cost, nodes=5, final_time=1.0, initial={T: start}, final={T: end})
    solution = problem.solve()
    assert solution.solved
    assert len(calls) >= 3
