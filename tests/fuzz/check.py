"""A case on all of its paths against NumPy."""

import warnings
from dataclasses import replace

import jax
import numpy as np
from oracle import oracle
from paths import Wrong, given, values
from slopes import wrong_derivatives
from term import Case, Term

import twistax as tx


def check(case: Case) -> str:
    """What is wrong, in a line; nothing if nothing is."""
    points = case.points()
    judged = [[oracle(point, term) for term in case.terms] for point in points]
    said = [k for k in range(len(case.terms)) if any(own[k] is not None for own in judged)]
    if not said:
        return ""
    case = replace(case, terms=tuple(case.terms[k] for k in said))
    points, judged = case.points(), [[own[k] for k in said] for own in judged]
    first = points[0]
    path = "build"
    try:
        with jax.enable_x64(not case.narrow), warnings.catch_warnings():
            # A kernel that its own check refuses is wrong, though XLA computes in its place.
            warnings.filterwarnings("error", "no native kernel")
            for path, k, found in values(points):
                for expected, value, tree in zip(judged[k], found, first.expressions, strict=True):
                    if expected is not None and (wrong := _apart(points[k], tree, np.asarray(value), *expected)):
                        return f"{path}: {wrong}"
            if case.differentiated and not (case.single or case.whole or case.narrow):
                path = "values"
                smooth = [term for term, own in zip(case.terms, judged[0], strict=True) if _is_smooth(term, own)]
                return wrong_derivatives(replace(first, terms=tuple(smooth))) if smooth else ""
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


def _is_smooth(term: Term, expected: tuple[np.ndarray, np.ndarray] | None) -> bool:
    """Whether it has a value, and does not round to fewer digits on the way, which no noise stands for."""
    rounds = any("float32" in part.setup or "reduce_precision" in part.setup for part in term.walk())
    return expected is not None and bool(np.all(np.isfinite(expected[0]))) and not rounds
