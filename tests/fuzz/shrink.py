"""The smallest case that is wrong in the same way."""

import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from term import Case, Term

#: Seconds of processor time after which the smallest case so far is taken.
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
    if case.more:
        yield from case.points()
    half = len(case.terms) // 2
    if half > 1:
        yield replace(case, terms=case.terms[:half])
        yield replace(case, terms=case.terms[half:])
    for k in range(len(case.terms) if len(case.terms) > 1 else 0):
        yield replace(case, terms=case.terms[k : k + 1])
    for k in range(len(case.terms) if len(case.terms) > 2 else 0):
        yield replace(case, terms=case.terms[:k] + case.terms[k + 1 :])
    for k, term in enumerate(case.terms):
        for smaller in smaller_terms(term):
            yield replace(case, terms=(*case.terms[:k], smaller, *case.terms[k + 1 :]))
    for name in case.settings:
        yield replace(case, **{name: False})
    for name in case.baked:
        yield replace(case, baked=tuple(other for other in case.baked if other != name))
    for name, value in case.used().items():
        for simple in (np.zeros_like(value), np.ones_like(value), np.round(value)):
            if not np.array_equal(simple, value, equal_nan=True):
                yield replace(case, leaves=case.leaves | {name: simple})


def weight(case: Case) -> tuple[int, int, int, int]:
    digits = sum(len(repr(value.tolist())) for value in case.used().values())
    return len(case.terms), sum(1 for _ in case.walk()), len(case.baked) + len(case.settings) + len(case.more), digits


def path_of(said: str) -> str:
    return said.split(":")[0].removesuffix(", vmap")


def smallest(case: Case, check: Callable[[Case], str], wrong: str) -> tuple[Case, str]:
    """The case shrunk as long as it stays wrong on the same path, and what is wrong with it."""
    end = time.process_time() + LIMIT
    found = True
    while found and time.process_time() < end:
        found = False
        for simpler in simpler_cases(case):
            if weight(simpler) >= weight(case):
                continue
            said = check(simpler)
            # One term of many may be wrong elsewhere first.
            if said and (path_of(said) == path_of(wrong) or len(simpler.terms) < len(case.terms)):
                case, wrong, found = simpler, said, True
                break
            if time.process_time() > end:
                break
    return case, wrong
