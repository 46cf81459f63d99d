"""Every way to a number: arrays, scalars, kernels, under transformations, and what they are compared with."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from term import Case, Term

import twistax as tx

#: Noise is put on each operation, so many times that of rounding, and a result may be off by so many of its spreads.
NOISE, SPREADS, SAMPLES = 2.0, 100.0, 6
#: Sizes beyond which ranges end: a quotient may be a product with a reciprocal, and XLA drops subnormal numbers.
RANGE = {np.float64: (1e-150, 1e150), np.float32: (1e-15, 1e15)}
#: Of the difference quotients that stand for derivatives of NumPy's values.
STEP = 1e-5

#: The same system by each backend; small programs too become scalars.
BACKENDS = {
    "arrays": tx.JAX(),
    "scalars": tx.XLA(least=0),
    "kernel": tx.Native(least=0, scalars=tx.XLA(least=0)),
}


class Wrong(Exception):
    """What is no number, and wrong all the same."""


def oracle(case: Case, term: Term) -> tuple[np.ndarray, np.ndarray] | None:
    """NumPy's value and how far rounding may move it, by noise on each operation. None where that says nothing."""
    generator = np.random.default_rng(0)
    eps = float(np.finfo(case.dtype).eps)

    def noisy(value: Any) -> Any:
        value = np.asarray(value)
        if value.dtype != np.float64:
            return value
        return value * (1.0 + NOISE * eps * generator.uniform(-1.0, 1.0, value.shape))

    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if case.extreme:
            rounded = {name: value.astype(case.dtype) for name, value in case.leaves.items()}
            value = np.asarray(term.value(rounded)[0], case.dtype)
            return value, 2000 * eps * np.where(np.isfinite(value), np.abs(value), 0.0)
        # Matrices that single precision rounds are other ones where they are nearly singular.
        leaves = {name: value.astype(case.dtype).astype(float) for name, value in case.leaves.items()}
        try:
            value, met = term.value(leaves)
            samples = [np.asarray(term.value(leaves, noisy)[0], float) for _ in range(SAMPLES)]
        except (np.linalg.LinAlgError, ValueError):
            return None
        value = np.asarray(value, float)
        sizes = np.abs(np.concatenate([np.ravel(np.asarray(part, float)) for part in met]))
        least, largest = RANGE[case.dtype]
        # Zero times infinity is zero where the zero is known, as docs/lowering.md says: NumPy shows these as NaN.
        if np.any(np.isnan(sizes)) or np.any((sizes > largest) & np.isfinite(sizes)):
            return None
        if np.any((sizes < least) & (sizes > 0.0)):
            return None
        spread = np.max([np.where(sample == value, 0.0, np.abs(sample - value)) for sample in samples], axis=0)
    finite = np.isfinite(value)
    if not np.all(np.isfinite(spread)) or np.any(spread[finite] > 1e-3 * (1.0 + np.abs(value[finite]))):
        return None
    met_at_most = float(np.max(sizes[np.isfinite(sizes)], initial=0.0))
    return value, SPREADS * spread + 8 * eps * (1.0 + met_at_most) + 2000 * eps * np.where(finite, np.abs(value), 0.0)


def given(case: Case, *trees: tx.Expr) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
    """States, controls and parameters of these trees."""
    nodes = list(tx.expr.postorder(*trees))
    kinds = (tx.State, tx.Control, tx.Parameter)
    x, u, p = ({n.name: case.given(n.name) for n in nodes if isinstance(n, kind)} for kind in kinds)
    return x, u, p


def functions(case: Case) -> Iterator[tuple[str, Callable[..., Any], tuple[Any, ...]]]:
    """The outputs of a system by each backend: its name, a function, and the arguments."""
    expressions = case.expressions()
    leaves = {node.name: node for node in tx.expr.postorder(*expressions) if isinstance(node, tx.State)}
    leaves["clock"] = tx.State("clock")
    outputs = {f"y{k}": expression for k, expression in enumerate(expressions)}
    whole = tx.System(rates={leaf: 0.0 * leaf for leaf in leaves.values()}, outputs=outputs)
    x, u, p = given(case, *expressions)
    x["clock"] = np.zeros((), case.dtype)
    bake = {name: np.asarray(case.leaves[name], float) for name in case.baked if p.pop(name, None) is not None}
    for name, backend in BACKENDS.items():
        dynamics = tx.compile(whole, backend=backend, bake=bake)

        def run(x: Any, u: Any, p: Any, own: tx.Dynamics = dynamics) -> list[Any]:
            found = own.outputs(0.0, x, u, p)
            return [found[name] for name in outputs]

        yield name, run, (x, u, p)


def values(case: Case) -> Iterator[tuple[str, list[Any]]]:
    """The values on each path, with the path's name."""
    expressions = case.expressions()
    canonical = [expression.canonicalize() for expression in expressions]
    if any(tree.canonicalize().key() != tree.key() for tree in canonical):
        raise Wrong("canonicalize: a canonical tree does not stay as it is")
    by_jit = {} if case.whole else {"tx.lower": expressions, "canonicalize": canonical}  # jit itself cuts long integers
    for name, trees in by_jit.items():
        yield name, jax.jit(tx.lower(tuple(trees)))(0.0, *given(case, *trees))
    for name, outputs, arguments in functions(case):
        if case.batched:
            axis = -(len(case.used()) % 2)  # along the first or the last one
            batch = jax.tree.map(lambda leaf, axis=axis: jnp.stack([jnp.zeros_like(leaf), leaf], axis), arguments)
            yield f"{name}, vmap", [value[1] for value in jax.jit(jax.vmap(outputs, in_axes=axis))(*batch)]
        else:
            yield name, outputs(*arguments)


# ---- derivatives -----------------------------------------------------------------------------------------------------


def slope(case: Case, term: Term, weights: np.ndarray, along: dict[str, np.ndarray]) -> float | None:
    """The derivative of NumPy's value along leaves by difference quotients; None at kinks, and for nodes of users."""
    if any(part.setup for part in term.walk()):
        return None

    def at(distance: float) -> float:
        leaves = {name: value + distance * along.get(name, 0.0) for name, value in case.leaves.items()}
        return float(np.sum(weights * np.asarray(term.value(leaves)[0], float)))

    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            ahead, behind, here, near, far = (at(k * STEP) for k in (1.0, -1.0, 0.0, 0.5, -0.5))
        except (np.linalg.LinAlgError, ValueError):
            return None
    wide, close, one_side, other_side = ahead - behind, 2.0 * (near - far), 2.0 * (ahead - here), 2.0 * (here - behind)
    found = wide / (2.0 * STEP)
    apart = max(abs(wide - close), 1e-3 * abs(one_side - other_side)) / (2.0 * STEP)
    return found if apart <= 1e-6 * (1.0 + abs(found)) and abs(here) < 1e3 * (1.0 + abs(found)) else None


def wrong_derivatives(case: Case) -> str:
    """Whether derivatives of scalars and kernels are those on arrays, forward ones reverse ones, and NumPy's slopes."""
    generator = np.random.default_rng(1)
    weights = [generator.normal(size=term.shape) for term in case.terms]
    expected = spread = None
    for name, outputs, arguments in functions(case):

        def totals(*arguments: Any, outputs: Callable[..., Any] = outputs) -> Any:
            """One number of each term."""
            return jnp.stack([jnp.sum(w * value) for w, value in zip(weights, outputs(*arguments), strict=True)])

        def both(arguments: Any, along: Any, totals: Callable[..., Any] = totals) -> Any:
            """By reverse mode, a row for each term, and by forward mode."""
            one = len(weights) == 1
            back = jax.grad(lambda *a: totals(*a)[0], (0, 1, 2)) if one else jax.jacrev(totals, (0, 1, 2))
            return back(*arguments), jax.jvp(totals, arguments, along)[1]

        tangent = jax.tree.map(lambda leaf: np.cos(1.0 + np.arange(leaf.size)).reshape(leaf.shape), arguments)
        derivatives = jax.jit(both)
        try:
            gradient, along = derivatives(arguments, tangent)
        except (ValueError, NotImplementedError):
            if expected is None:  # JAX itself has no such derivative
                return ""
            raise
        found, along = rows(gradient, len(weights)), np.asarray(along)
        if expected is None or spread is None:
            expected = found
            nearby = [
                jax.tree.map(lambda leaf: leaf * (1.0 + 1e-13 * generator.normal()), arguments) for _ in range(SAMPLES)
            ]
            samples = [rows(derivatives(point, tangent)[0], len(weights)) for point in nearby]
            spread = np.max([np.abs(sample - found) for sample in samples], axis=0)
            sizes = 1.0 + np.max(np.abs(expected), axis=1, initial=0.0, keepdims=True)
            good = np.all(np.isfinite(expected) & (spread <= 1e-4 * sizes), axis=1) & (sizes[:, 0] < 1e8)
            spread = 10.0 * spread + 1e-9 * sizes
            flat, named = rows(tangent, 1)[0], tangent[0] | tangent[1] | tangent[2]
            each = zip(case.terms, weights, good, strict=True)
            slopes = [slope(case, term, w, named) if ok else None for term, w, ok in each]
        off = np.abs(found - expected)[good] > spread[good]
        if np.any(off | np.isnan(found[good])):
            return f"{name}, grad: {found.tolist()} for {expected.tolist()}"
        allowed = spread @ np.abs(flat) + 1e-9 * sizes[:, 0]
        if not np.all((np.abs(along - expected @ flat) <= allowed)[good]):
            return f"{name}, jvp: {along.tolist()} for {(expected @ flat).tolist()}"
        for k, by_differences in enumerate(slopes):
            if by_differences is not None and not abs(along[k] - by_differences) <= allowed[k] + 1e-4 * (
                1.0 + abs(by_differences)
            ):
                return f"{name}, slope: {along[k]} for {by_differences} of term {k}"
    return ""


def rows(tree: Any, count: int) -> np.ndarray:
    """The derivatives of `count` numbers, a row each."""
    leaves = [np.reshape(np.asarray(leaf, float), (count, -1)) for leaf in jax.tree.leaves(tree)]
    return np.concatenate(leaves, axis=1) if leaves else np.zeros((count, 0))


# ---- all of it -------------------------------------------------------------------------------------------------------


def check(case: Case) -> str:
    """What is wrong, in a line; nothing if nothing is."""
    judged = [(term, found) for term in case.terms if (found := oracle(case, term)) is not None]
    if not judged:
        return ""
    case = replace(case, terms=tuple(term for term, _ in judged))
    path = "build"
    try:
        with jax.enable_x64(not case.narrow):
            for path, found in values(case):
                for (_, (expected, tolerance)), value, tree in zip(judged, found, case.expressions(), strict=True):
                    if wrong := _apart(case, tree, np.asarray(value), expected, tolerance):
                        return f"{path}: {wrong}"
            if case.differentiated and not (case.single or case.whole or case.narrow):
                path = "values"
                smooth = [term for term, (value, _) in judged if np.all(np.isfinite(value)) and not _rounds(term)]
                return wrong_derivatives(replace(case, terms=tuple(smooth))) if smooth else ""
    except tx.OrderError:
        return ""  # twists of two orders that met by chance
    except Exception as error:
        return f"after {path}: {type(error).__name__}: {str(error)[:300]}"
    return ""


def _apart(case: Case, tree: tx.Expr, value: np.ndarray, expected: np.ndarray, tolerance: np.ndarray) -> str:
    if value.shape != expected.shape:
        return f"shape {value.shape} for {expected.shape}"
    # Constants alone have the precision that JAX gives them.
    if value.dtype != case.dtype and any(given(case, tree.canonicalize())) and not case.whole:
        return f"{value.dtype} for {np.dtype(case.dtype)}"
    with np.errstate(all="ignore"):
        off = np.where((value == expected) | (np.isnan(value) & np.isnan(expected)), 0.0, np.abs(value - expected))
    return "" if np.all(off <= tolerance) else f"{value.tolist()} for {expected.tolist()}, off by {np.max(off):.2g}"


def _rounds(term: Term) -> bool:
    """Whether it rounds to fewer digits on the way, which no noise stands for."""
    return any("float32" in part.setup or "reduce_precision" in part.setup for part in term.walk())
