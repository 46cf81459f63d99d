"""Every way to a number: arrays, scalars, kernels, as users call them, jitted and in batches."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from typing import Any

import jax
import numpy as np
from term import Case

import twistax as tx

#: The same system by each backend; small programs too become scalars.
BACKENDS = {
    "arrays": tx.JAX(),
    "scalars": tx.XLA(least=0),
    "kernel": tx.Native(least=0, scalars=tx.XLA(least=0)),
}


class Wrong(Exception):
    """What is no number, and wrong all the same."""


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
    # The number that a call would give: a baked one is folded in double precision.
    bake = {name: np.asarray(p.pop(name), case.dtype).astype(float) for name in case.baked if name in p}
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
    functions = dynamics.functions
    try:
        inputs = functions.prepare(0.0, x, u, p, reads=("outputs",))
        leaves, structure = jax.tree.flatten((inputs.t, inputs.x, inputs.u, inputs.params))
        emission, _ = functions.emission("outputs", structure, tuple((leaf.shape, leaf.dtype) for leaf in leaves))
    except Exception:  # which a call raises too, and `check` reports
        return False
    return emission.program is not None and "not native" not in emission.reason


def values(points: Sequence[Case]) -> Iterator[tuple[str, int, list[Any]]]:
    """The values of one case on each path, for each of its points: the path's name, which point, the values."""
    case = points[0]
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
    given_all = [given(point, *expressions) for point in points]
    for own in given_all:
        own[0]["clock"] = np.zeros((), case.dtype)
    if case.called:
        # Step by step each step of each shape would be compiled: a hundred programs.
        paths |= {name: jax.jit(paths[name]) for name in ("tx.lower", "canonicalize") if name in paths}
        for name, path in paths.items():
            for k, own in enumerate(given_all):
                yield name, k, path(*own)
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
        together = jax.jit(all_paths)
        for k, own in enumerate(given_all):
            for name, found in zip(paths, together(*own), strict=True):
                yield name, k, found
        return
    axis = -(len(case.used()) % 2)  # along the first or the last one
    batch = jax.tree.map(lambda *leaves: np.stack([np.zeros_like(leaves[0]), *leaves], axis), *given_all)
    for name, found in zip(paths, jax.jit(jax.vmap(all_paths, in_axes=axis))(*batch), strict=True):
        for k in range(len(points)):
            yield f"{name}, vmap", k, [np.asarray(value)[k + 1] for value in found]


def _lowered(trees: Sequence[tx.Expr]) -> Callable[..., Any]:
    leaves = {node.name for node in tx.expr.postorder(*trees) if isinstance(node, tx.State | tx.Control | tx.Parameter)}
    function = tx.lower(tuple(trees))
    return lambda *given: function(0.0, *(_only(own, leaves) for own in given))


def _only(values: Mapping[str, Any], names: Container[str]) -> dict[str, Any]:
    return {name: value for name, value in values.items() if name in names}
