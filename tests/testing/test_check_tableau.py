"""`check_tableau` runs over every tableau of the package, and sees a wrong digit and a wrong label."""

import importlib
from typing import Any

import numpy as np
import pytest

import twistax as tx
from registered import every_module
from twistax.tableaus import ButcherTableau, CollocationTableau, CommutatorFreeTableau
from twistax.testing import LawError, check_tableau

KINDS = (ButcherTableau, CollocationTableau, CommutatorFreeTableau)


def every_tableau() -> list[Any]:
    """Those that a module of the package has by name, or in a tuple: each once."""
    values = [value for name in every_module() for value in vars(importlib.import_module(name)).values()]
    values += [entry for value in values if isinstance(value, tuple) for entry in value]
    return sorted({id(v): v for v in values if isinstance(v, KINDS)}.values(), key=lambda tableau: tableau.name)


TABLEAUS = every_tableau()


@pytest.mark.parametrize("tableau", TABLEAUS, ids=lambda tableau: tableau.name)
def test_every_tableau_keeps_the_laws(tableau: Any) -> None:
    check_tableau(tableau)


def test_all_tableaus_are_public() -> None:
    public = {id(value) for value in vars(tx.tableaus).values()} | {id(tableau) for tableau in tx.tableaus.ALL}
    assert [tableau.name for tableau in TABLEAUS if id(tableau) not in public] == []
    assert {type(tableau) for tableau in TABLEAUS} == set(KINDS)


def spoiled() -> ButcherTableau:
    RK4 = tx.tableaus.RK4
    a = np.array(RK4.a)
    a[2] = [0.25, 0.25, 0.0, 0.0]
    return ButcherTableau("spoiled", 4, a, RK4.b, RK4.c)


STEPS = np.array(tx.tableaus.CF4.b)


@pytest.mark.parametrize(
    ("tableau", "words"),
    [
        (spoiled(), "the conditions of order 3 of the solution"),
        (ButcherTableau("labelled", 3, tx.tableaus.HEUN.a, tx.tableaus.HEUN.b, tx.tableaus.HEUN.c), "order 3"),
        # Its sums are those of the classical method of order 4; its exponentials do not stand in the order they must.
        (
            CommutatorFreeTableau("turned", 4, tx.tableaus.CF4.a, tx.tableaus.CF4.b[::-1]),
            "converges with the order of the tableau",
        ),
        # The order of large steps is 4.4, that of small ones 2.
        (
            CommutatorFreeTableau("turned a little", 4, tx.tableaus.CF4.a, 0.999 * STEPS + 0.001 * STEPS[::-1]),
            "converges with the order of the tableau",
        ),
        (
            ButcherTableau("labelled too low", 1, tx.tableaus.RK4.a, tx.tableaus.RK4.b, tx.tableaus.RK4.c),
            "the order can be measured",
        ),
    ],
    ids=lambda value: getattr(value, "name", ""),
)
def test_an_error_is_seen(tableau: Any, words: str) -> None:
    with pytest.raises(LawError, match=words):
        check_tableau(tableau)


@pytest.mark.usefixtures("unchecked")
def test_what_is_no_tableau_is_refused() -> None:
    with pytest.raises(tx.InputError, match=r"check_tableau expects a tableau such as tx\.tableaus\.RK4"):
        check_tableau(tx.RKMK(tx.tableaus.RK4))  # type: ignore[arg-type]
