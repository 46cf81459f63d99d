"""Derivatives on every path: as those on arrays, forward ones as reverse ones, and as slopes of NumPy's values."""

import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from oracle import SAMPLES, uncertainty
from paths import Wrong, functions
from term import Case, Term

#: Of the difference quotients that stand for derivatives of NumPy's values.
STEP = 1e-5


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


class NoDerivative(Exception):
    """JAX itself has none."""


def wrong_derivatives(case: Case) -> str:
    """Whether derivatives of scalars or kernels are those on arrays, forward ones reverse ones, and NumPy's slopes."""
    generator = np.random.default_rng(1)
    weights = [generator.normal(size=term.shape) for term in case.terms]
    backends = [own for own in functions(case) if own[0] != ("scalars" if case.batched else "kernel")]
    arguments = backends[0][2]

    @jax.jit
    def derivatives(arguments: Any, along: Any, cotangent: Any) -> list[Any]:
        """For each backend the derivatives of one number of each term: reverse along a cotangent, and forward."""
        found: list[Any] = []
        for name, outputs, _ in backends:

            def totals(*arguments: Any, outputs: Callable[..., Any] = outputs) -> Any:
                own = outputs(*arguments)
                return jnp.stack([jnp.sum(w * value) for w, value in zip(weights, own, strict=True)])

            try:
                back = jax.vjp(totals, *arguments)[1](cotangent)
                # Of arrays, which come first, NumPy's slopes are enough.
                found.append((back, jax.jvp(totals, arguments, along)[1] if found else None))
            except (ValueError, NotImplementedError) as error:
                raise Wrong(f"{name}, grad: {error}") if found else NoDerivative from error
        return found

    tangent = jax.tree.map(lambda leaf: np.cos(1.0 + np.arange(leaf.size)).reshape(leaf.shape), arguments)
    units = np.eye(len(weights))

    def gradients(arguments: Any) -> list[list[Any]]:
        """For each term what `derivatives` gives."""
        return [derivatives(arguments, tangent, unit) for unit in units]

    try:
        here = gradients(arguments)
    except NoDerivative:
        half = len(case.terms) // 2
        parts = (case.terms[:half], case.terms[half:]) if half else ()
        return next(filter(None, (wrong_derivatives(replace(case, terms=part)) for part in parts)), "")
    by_backend = [np.stack([flattened(row[k][0]) for row in here]) for k in range(len(backends))]
    expected = by_backend[0]
    # Each entry by itself: what cancels for multiples of a matrix does not in rounding.
    nearby = [
        jax.tree.map(lambda leaf: leaf * (1.0 + 1e-13 * generator.normal(size=leaf.shape)), arguments)
        for _ in range(SAMPLES)
    ]
    samples = [np.stack([flattened(row[0][0]) for row in gradients(point)]) for point in nearby]
    spread = np.max([np.abs(sample - expected) for sample in samples], axis=0)
    sizes = 1.0 + np.max(np.abs(expected), axis=1, initial=0.0, keepdims=True)
    good = np.all(np.isfinite(expected) & (spread <= 1e-4 * sizes), axis=1) & (sizes[:, 0] < 1e8)
    # Constants do not move; what they make uncertain in values they do in derivatives.
    doubts = np.array([[uncertainty(case, term)] for term in case.terms])
    rough = (1e-9 + doubts) * sizes
    spread = 10.0 * spread + rough
    flat, named = flattened(tangent), tangent[0] | tangent[1] | tangent[2]
    each = zip(case.terms, weights, good, strict=True)
    slopes = [slope(case, term, w, named) if ok else None for term, w, ok in each]
    allowed = spread @ np.abs(flat) + rough[:, 0]
    for k, (name, found) in enumerate(zip((name for name, _, _ in backends), by_backend, strict=True)):
        off = np.abs(found - expected)[good] > spread[good]
        if np.any(off | np.isnan(found[good])):
            return f"{name}, grad: {found.tolist()} for {expected.tolist()}"
        along = np.asarray(here[0][k][1]) if k else expected @ flat
        if not np.all((np.abs(along - expected @ flat) <= allowed)[good]):
            return f"{name}, jvp: {along.tolist()} for {(expected @ flat).tolist()}"
        for i, by_differences in enumerate(slopes):
            if by_differences is not None and not abs(along[i] - by_differences) <= allowed[i] + 1e-4 * (
                1.0 + abs(by_differences)
            ):
                return f"{name}, slope: {along[i]} for {by_differences} of term {i}"
    return ""


def flattened(tree: Any) -> np.ndarray:
    """All entries in one vector."""
    return np.concatenate([np.zeros(0), *(np.reshape(np.asarray(leaf, float), -1) for leaf in jax.tree.leaves(tree))])
