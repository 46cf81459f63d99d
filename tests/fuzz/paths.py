"""Every way to a number: arrays, scalars, kernels, under transformations, and what they are compared with."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
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


def uncertainty(case: Case, term: Term) -> float:
    """How far rounding may move a value, as a share of it."""
    found = oracle(case, term)
    if found is None:
        return np.inf
    value, tolerance = (np.where(np.isfinite(found[0]), each, 0.0) for each in found)
    return float(np.max(tolerance, initial=0.0) / (1.0 + np.max(np.abs(value), initial=0.0)))


def given(case: Case, *trees: tx.Expr) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
    """States, controls and parameters of these trees."""
    nodes = list(tx.expr.postorder(*trees))
    kinds = (tx.State, tx.Control, tx.Parameter)
    x, u, p = ({n.name: case.given(n.name) for n in nodes if isinstance(n, kind)} for kind in kinds)
    return x, u, p


def functions(case: Case) -> Iterator[tuple[str, Callable[..., Any], tuple[Any, ...]]]:
    """The outputs of a system by each backend: its name, a function, and the arguments."""
    expressions = case.expressions
    leaves = {node.name: node for node in tx.expr.postorder(*expressions) if isinstance(node, tx.State)}
    leaves["clock"] = tx.State("clock")
    outputs = {f"y{k}": expression for k, expression in enumerate(expressions)}
    whole = tx.System(rates={leaf: 0.0 * leaf for leaf in leaves.values()}, outputs=outputs)
    x, u, p = given(case, *expressions)
    x["clock"] = np.zeros((), case.dtype)
    bake = {name: np.asarray(case.leaves[name], float) for name in case.baked if p.pop(name, None) is not None}
    for name, backend in BACKENDS.items():

        def compiled(*names: str, backend: Any = backend) -> tx.Dynamics:
            return tx.compile(whole, outputs=names, backend=backend, bake=bake)

        parts = [compiled(*outputs)]
        if name != "arrays" and not has_form(parts[0], x, u, p):
            # A term without a form of its own would take the form from all that it is compiled with.
            alone = {each: has_form(compiled(each), x, u, p) for each in outputs}
            groups = [[each for each, has in alone.items() if has is wanted] for wanted in (True, False)]
            parts = [compiled(*group) for group in groups if group]

        def run(x: Any, u: Any, p: Any, parts: Sequence[tx.Dynamics] = parts) -> list[Any]:
            found = {each: value for own in parts for each, value in own.outputs(0.0, x, u, p).items()}
            return [found[each] for each in outputs]

        yield name, run, (x, u, p)


def has_form(dynamics: tx.Dynamics, x: Any, u: Any, p: Any) -> bool:
    """Whether the outputs run as scalars, by native backends as a kernel, and not as arrays."""
    functions = dynamics._functions
    try:
        inputs = functions.prepare(0.0, x, u, p, reads=("outputs",))
        leaves, structure = jax.tree.flatten((inputs.t, inputs.x, inputs.u, inputs.params))
        emission, _ = functions.emission("outputs", structure, tuple((leaf.shape, leaf.dtype) for leaf in leaves))
    except Exception:  # which a call raises too, and `check` reports
        return False
    return emission.program is not None and "not native" not in emission.reason


def values(case: Case) -> Iterator[tuple[str, list[Any]]]:
    """The values on each path, with the path's name."""
    expressions = case.expressions
    canonical = [expression.canonicalize() for expression in expressions]
    if any(tree.canonicalize().key() != tree.key() for tree in canonical):
        raise Wrong("canonicalize: a canonical tree does not stay as it is")
    paths: dict[str, Callable[..., Any]] = {}
    if not case.whole:  # jit itself cuts long integers
        paths = {"tx.lower": _lowered(expressions), "canonicalize": _lowered(canonical)}
    for name, outputs, arguments in functions(case):
        names = [set(own) for own in arguments]
        paths[name] = lambda *given, run=outputs, names=names: run(*map(_only, given, names))
    given_all = given(case, *expressions)
    given_all[0]["clock"] = np.zeros((), case.dtype)
    if case.called:
        for name, path in paths.items():
            yield name, path(*given_all)
        return

    def all_paths(*arguments: Any) -> list[Any]:
        found = []
        for name, path in paths.items():
            try:
                found.append(path(*arguments))
            except tx.OrderError:
                raise
            except Exception as error:
                raise Wrong(f"{name}: {type(error).__name__}: {str(error)[:300]}") from error
        return found

    if not case.batched:
        yield from zip(paths, jax.jit(all_paths)(*given_all), strict=True)
        return
    axis = -(len(case.used()) % 2)  # along the first or the last one
    batch = jax.tree.map(lambda leaf: np.stack([np.zeros_like(leaf), leaf], axis), given_all)
    for name, found in zip(paths, jax.jit(jax.vmap(all_paths, in_axes=axis))(*batch), strict=True):
        yield f"{name}, vmap", [np.asarray(value)[1] for value in found]


def _lowered(trees: Sequence[tx.Expr]) -> Callable[..., Any]:
    leaves = {node.name for node in tx.expr.postorder(*trees) if isinstance(node, tx.State | tx.Control | tx.Parameter)}
    function = tx.lower(tuple(trees))
    return lambda *given: function(0.0, *(_only(own, leaves) for own in given))


def _only(values: Mapping[str, Any], names: Container[str]) -> dict[str, Any]:
    return {name: value for name, value in values.items() if name in names}


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


# ---- all of it -------------------------------------------------------------------------------------------------------


def check(case: Case) -> str:
    """What is wrong, in a line; nothing if nothing is."""
    judged = [(term, found) for term in case.terms if (found := oracle(case, term)) is not None]
    if not judged:
        return ""
    case = replace(case, terms=tuple(term for term, _ in judged))
    path = "build"
    try:
        with jax.enable_x64(not case.narrow), warnings.catch_warnings():
            # A kernel that its own check refuses is wrong, though XLA computes in its place.
            warnings.filterwarnings("error", "no native kernel")
            for path, found in values(case):
                for (_, (expected, tolerance)), value, tree in zip(judged, found, case.expressions, strict=True):
                    if wrong := _apart(case, tree, np.asarray(value), expected, tolerance):
                        return f"{path}: {wrong}"
            if case.differentiated and not (case.single or case.whole or case.narrow):
                path = "values"
                smooth = [term for term, (value, _) in judged if np.all(np.isfinite(value)) and not _rounds(term)]
                return wrong_derivatives(replace(case, terms=tuple(smooth))) if smooth else ""
    except tx.OrderError:  # twists of two orders that met by chance
        parts = [replace(case, terms=(term,)) for term in case.terms] if len(case.terms) > 1 else []
        return next(filter(None, map(check, parts)), "")
    except Wrong as error:
        return str(error)
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
