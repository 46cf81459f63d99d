"""The smallest case that is wrong in the same way."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from term import Case, Term

#: Seconds after which the smallest case so far is taken.
LIMIT = 30.0


def smaller_terms(term: Term) -> Iterator[Term]:
    """The largest savings first."""
    parts = list(term.walk())
    yield from sorted(parts[:-1], key=Term.size)
    for part in reversed(parts):
        for arg in part.args:
            for inner in arg.walk():
                if inner.shape == part.shape:
                    yield term.replaced(part, inner)
    for part in parts:
        if part.args:
            for value in (0.0, 1.0):
                full = np.full(part.shape, value)
                constant = Term(f"tx.Constant(np.full({part.shape}, {value}))", lambda full=full: full, (), part.shape)
                yield term.replaced(part, constant)


def simpler_cases(case: Case) -> Iterator[Case]:
    for term in smaller_terms(case.term):
        yield replace(case, term=term)
    for name in ("batched", "single", "differentiated"):
        if getattr(case, name):
            yield replace(case, **{name: False})
    for name in case.baked:
        yield replace(case, baked=tuple(other for other in case.baked if other != name))
    for name, value in case.used().items():
        for simple in (np.zeros_like(value), np.ones_like(value), np.round(value)):
            if not np.array_equal(simple, value, equal_nan=True):
                yield replace(case, leaves=case.leaves | {name: simple})


def weight(case: Case) -> tuple[int, int, int]:
    used = case.used().values()
    digits = sum(len(repr(value.tolist())) for value in used)
    return case.term.size(), len(case.baked) + case.batched + case.single + case.differentiated, digits


def smallest(case: Case, check: Callable[[Case], str], wrong: str) -> tuple[Case, str]:
    """The case shrunk as long as it stays wrong on the same path, and what is wrong with it."""
    path, end = wrong.split(":")[0], time.monotonic() + LIMIT
    found = True
    while found and time.monotonic() < end:
        found = False
        for simpler in simpler_cases(case):
            if weight(simpler) >= weight(case):
                continue
            if (said := check(simpler)).split(":")[0] == path:
                case, wrong, found = simpler, said, True
                break
            if time.monotonic() > end:
                break
    return case, wrong
