"""What a term is by NumPy, and how far rounding may move it."""

import warnings
from typing import Any

import numpy as np
from term import Case, Term

#: Noise is put on each operation, so many times that of rounding, and a result may be off by so many of its spreads.
#: Samples that all decide a tie alike would hide it: by chance they do so once in 2^SAMPLES ties.
NOISE, SPREADS, SAMPLES = 2.0, 100.0, 24
#: Sizes beyond which ranges end: a quotient may be a product with a reciprocal, and XLA drops subnormal numbers.
RANGE = {np.float64: (1e-150, 1e150), np.float32: (1e-15, 1e15)}


def oracle(case: Case, term: Term) -> tuple[np.ndarray, np.ndarray] | None:
    """NumPy's value and how far rounding may move it, by noise on each operation. None where that says nothing."""
    generator = np.random.default_rng(0)
    eps = float(np.finfo(case.dtype).eps)

    def noisy(value: Any, far: Any) -> Any:
        value = np.asarray(value)
        if value.dtype != np.float64:
            return value
        own = NOISE * eps * generator.uniform(-1.0, 1.0, value.shape)
        return value * (1.0 + own) + eps / SPREADS * far * generator.choice((-1.0, 1.0), value.shape)

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
