"""Messages of violated laws: the law, the tested object, the values, the size of the violation, and a remedy."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from typing import Any

import jax
import numpy as np

from ..errors import TwistaxError

#: The weights of a difference quotient of fourth order, by the number of steps, and its step.
STENCIL = {2: -1.0 / 12.0, 1: 2.0 / 3.0, -1: -2.0 / 3.0, -2: 1.0 / 12.0}
STEP = 1e-3


class LawError(TwistaxError, AssertionError):
    """A group, joint, node, tableau or scene violates a law. The message names the law, the values, the expected result
    and a remedy.

    Attributes:
        law: a short text of the law.
    """

    page = "docs/extending.md#checking-a-part"
    law: str = ""


class Check:
    """Comparisons for one tested object; a failed one raises LawError."""

    def __init__(self, subject: str) -> None:
        self.subject = subject

    def fail(self, law: str, what: str, fix: str) -> LawError:
        """The error for a violated law."""
        error = LawError(f"{self.subject} breaks the law {law!r}: {what}\n  fix: {fix}")
        error.law = law
        return error

    def holds(self, law: str, condition: Any, what: str, fix: str) -> None:
        """Raise LawError unless the condition is true."""
        if not condition:
            raise self.fail(law, what, fix)

    def close(
        self, law: str, actual: Any, expected: Any, tolerance: Any, fix: str, at: Mapping[str, Any] | None = None
    ) -> None:
        """Raise LawError unless two arrays are equal up to a tolerance, a number or an array for all entries."""
        actual, expected = np.asarray(actual), np.asarray(expected)
        place = "".join(f" {name} = {_shown(value)}," for name, value in (at or {}).items())
        where = f" at{place[:-1]}" if place else ""
        if actual.shape != expected.shape:
            what = f"got shape {actual.shape} for {expected.shape}{where}"
            raise self.fail(law, what, fix)
        with np.errstate(invalid="ignore", over="ignore"):
            off = np.abs(actual.astype(float) - expected.astype(float))
        if not (off <= tolerance).all():
            allowed = float(np.broadcast_to(tolerance, off.shape)[_worst(off - tolerance)])
            what = (
                f"got\n{_shown(actual)}\nfor\n{_shown(expected)}{where}, "
                f"off by {off[_worst(off - tolerance)]:.3g} where {allowed:.3g} is allowed"
            )
            raise self.fail(law, what, fix)

    @contextlib.contextmanager
    def running(self, law: str, fix: str) -> Iterator[None]:
        """A context in which errors of the tested object, while a law is evaluated, are raised as causes of a
        LawError.
        """
        try:
            yield
        except LawError:
            raise
        except Exception as error:
            raise self.fail(law, f"{type(error).__name__}: {error}", fix) from error


def _worst(excess: Any) -> Any:
    """Where an excess is largest, NaN counting as more than anything."""
    return np.unravel_index(int(np.argmax(np.nan_to_num(excess, nan=np.inf))), np.shape(excess))


def _shown(value: Any) -> str:
    return np.array2string(np.asarray(value), precision=8, threshold=40)


def flat(tree: Any) -> jax.Array:
    """All numbers of a pytree as one vector."""
    leaves = [leaf.reshape(-1) for leaf in jax.tree.leaves(tree)]
    return jax.numpy.concatenate(leaves) if leaves else jax.numpy.zeros(0)


def difference_quotient(values: Any, step: float = STEP) -> np.ndarray:
    """The derivative at 0 from values at the multiples of a step in STENCIL, in its order; its error is of the order of
    step^4.
    """
    return np.asarray(np.tensordot(list(STENCIL.values()), np.asarray(values), 1) / step)
