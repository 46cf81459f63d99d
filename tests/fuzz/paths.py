"""Every way to a number: arrays, scalars, kernels, under transformations, and what they are compared with."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from term import Case

import twistax as tx

#: Noise is put on each operation, so many times that of rounding, and a result may be off by so many of its spreads.
NOISE, SPREADS, SAMPLES = 2.0, 100.0, 6
#: Sizes beyond which ranges end: a quotient may be a product with a reciprocal, and XLA drops subnormal numbers.
LARGEST, SMALLEST = 1e150, 1e-150

#: The same system by each backend; small programs too become scalars.
BACKENDS = {
    "arrays": tx.JAX(),
    "scalars": tx.XLA(least=0),
    "kernel": tx.Native(least=0, scalars=tx.XLA(least=0)),
}


class Wrong(Exception):
    """What is no number, and wrong all the same."""


def precision(case: Case) -> float:
    return float(np.finfo(np.float32 if case.single else np.float64).eps)


def oracle(case: Case) -> tuple[np.ndarray, np.ndarray] | None:
    """NumPy's value and how far rounding may move it, by noise on each operation. None where that says nothing."""
    generator = np.random.default_rng(0)
    eps = precision(case)

    def noisy(value: Any) -> Any:
        value = np.asarray(value)
        if value.dtype != np.float64:
            return value
        return value * (1.0 + NOISE * eps * generator.uniform(-1.0, 1.0, value.shape))

    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            value, met = case.term.value(case.leaves)
            samples = [np.asarray(case.term.value(case.leaves, noisy)[0], float) for _ in range(SAMPLES)]
        except (np.linalg.LinAlgError, ValueError):
            return None
        value = np.asarray(value, float)
        sizes = np.abs(np.concatenate([np.ravel(np.asarray(part, float)) for part in met]))
        # Zero times infinity is zero where the zero is known, as docs/lowering.md says: NumPy shows these as NaN.
        if np.any(np.isnan(sizes)) or np.any((sizes > LARGEST) & np.isfinite(sizes)):
            return None
        if np.any((sizes < SMALLEST) & (sizes > 0.0)):
            return None
        spread = np.max([np.where(sample == value, 0.0, np.abs(sample - value)) for sample in samples], axis=0)
    finite = np.isfinite(value)
    if not np.all(np.isfinite(spread)) or np.any(spread[finite] > 1e-3 * (1.0 + np.abs(value[finite]))):
        return None
    largest = float(np.max(sizes[np.isfinite(sizes)], initial=0.0))
    return value, SPREADS * spread + 8 * eps * (1.0 + largest) + 2000 * eps * np.where(finite, np.abs(value), 0.0)


def given(case: Case, tree: tx.Expr) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
    """States, controls and parameters of this tree."""
    nodes = list(tx.expr.postorder(tree))
    dtype = np.float32 if case.single else np.float64
    kinds = (tx.State, tx.Control, tx.Parameter)
    x, u, p = ({n.name: case.leaves[n.name].astype(dtype) for n in nodes if isinstance(n, kind)} for kind in kinds)
    return x, u, p


def functions(case: Case, expression: tx.Expr) -> Iterator[tuple[str, Callable[..., Any], tuple[Any, ...]]]:
    """The output of a system by each backend: its name, a function, and the arguments."""
    leaves = [node for node in tx.expr.postorder(expression) if isinstance(node, tx.State)]
    clock = tx.State("clock")
    whole = tx.System(rates={leaf: 0.0 * leaf for leaf in (clock, *leaves)}, outputs={"y": expression})
    x, u, p = given(case, expression)
    x["clock"] = np.zeros((), np.float32 if case.single else np.float64)
    bake = {name: np.asarray(p.pop(name), float) for name in case.baked if name in p}
    for name, backend in BACKENDS.items():
        dynamics = tx.compile(whole, backend=backend, bake=bake)
        yield name, lambda x, u, p, dynamics=dynamics: dynamics.outputs(0.0, x, u, p)["y"], (x, u, p)


def values(case: Case) -> Iterator[tuple[str, Any]]:
    """The value on each path, with the path's name."""
    expression = case.term.expression()
    canonical = expression.canonicalize()
    if canonical.canonicalize().key() != canonical.key():
        raise Wrong("canonicalize: a canonical tree does not stay as it is")
    for name, tree in {"tx.lower": expression, "canonicalize": canonical}.items():
        yield name, jax.jit(tx.lower(tree))(0.0, *given(case, tree))
    for name, outputs, arguments in functions(case, expression):
        if case.batched:
            batch = jax.tree.map(lambda leaf: jnp.stack([jnp.zeros_like(leaf), leaf]), arguments)
            yield f"{name}, vmap", jax.jit(jax.vmap(outputs))(*batch)[1]
        else:
            yield name, outputs(*arguments)


def wrong_derivatives(case: Case) -> str:
    """Whether gradients of scalars and kernels are those on arrays, and forward ones are reverse ones."""
    generator = np.random.default_rng(1)
    weights = generator.normal(size=case.term.shape)
    expected = spread = None
    for name, outputs, arguments in functions(case, case.term.expression()):

        def total(*arguments: Any, outputs: Callable[..., Any] = outputs) -> Any:
            value = outputs(*arguments)
            return jnp.sum(jnp.asarray(weights, value.dtype) * value)

        gradient = jax.jit(jax.grad(total, (0, 1, 2)))
        try:
            found = flat(gradient(*arguments))
        except (ValueError, NotImplementedError):
            if expected is None:  # JAX itself has no such derivative
                return ""
            raise
        if expected is None or spread is None:
            samples = [
                flat(gradient(*jax.tree.map(lambda leaf: leaf * (1.0 + 1e-13 * generator.normal()), arguments)))
                for _ in range(SAMPLES)
            ]
            expected = found
            spread = np.max([np.abs(sample - found) for sample in samples], axis=0)
            if not np.all(np.isfinite(expected)) or not np.all(np.isfinite(spread)):
                return ""
            size = 1.0 + np.max(np.abs(expected), initial=0.0)
            if size > 1e8 or np.any(spread > 1e-4 * size):
                return ""
            spread = 10.0 * spread + 1e-9 * size
        if not np.all(np.abs(found - expected) <= spread):
            return f"{name}, grad: {found.tolist()} for {expected.tolist()}"
        tangent = jax.tree.map(lambda leaf: generator.normal(size=leaf.shape), arguments)
        along = jax.jit(lambda a, d, total=total: jax.jvp(total, a, d)[1])(arguments, tangent)
        if (
            not abs(float(along) - float(flat(tangent) @ expected))
            <= np.sum(np.abs(flat(tangent)) * spread) + 1e-9 * size
        ):
            return f"{name}, jvp: {float(along)} for {float(flat(tangent) @ expected)}"
    return ""


def flat(tree: Any) -> np.ndarray:
    leaves = jax.tree.leaves(tree)
    return np.concatenate([np.ravel(np.asarray(leaf, float)) for leaf in leaves]) if leaves else np.zeros(0)


def check(case: Case) -> str:
    """What is wrong, in a line; nothing if nothing is."""
    found = oracle(case)
    if found is None:
        return ""
    expected, tolerance = found
    path = "build"
    try:
        # Constants alone have the precision that JAX gives them.
        leaves_left = any(given(case, case.term.expression().canonicalize()))
        for path, value in values(case):
            value = np.asarray(value)
            if value.shape != expected.shape:
                return f"{path}: shape {value.shape} for {expected.shape}"
            if value.dtype != (np.float32 if case.single else np.float64) and leaves_left:
                return f"{path}: {value.dtype} for {'float32' if case.single else 'float64'}"
            with np.errstate(all="ignore"):
                off = np.where(value == expected, 0.0, np.abs(value - expected))
            if not np.all(off <= tolerance):
                return f"{path}: {value.tolist()} for {expected.tolist()}, off by {np.max(off):.2g}"
        rounded = any("float32" in term.setup or "reduce_precision" in term.setup for term in case.term.walk())
        if case.differentiated and not case.single and not rounded and np.all(np.isfinite(expected)):
            path = "values"
            return wrong_derivatives(case)
    except Exception as error:
        return f"after {path}: {type(error).__name__}: {str(error)[:300]}"
    return ""
