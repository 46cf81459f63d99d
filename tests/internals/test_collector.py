"""The search for garbage is off while programs are made, and afterwards as it was."""

import gc
import threading
from collections.abc import Iterator

import pytest

import twistax as tx
from twistax.expr.fields import Operand
from twistax.scalar.walk import uncollected


@pytest.fixture(autouse=True)
def as_before() -> Iterator[None]:
    was_on = gc.isenabled()
    gc.enable()
    yield
    (gc.enable if was_on else gc.disable)()


def test_it_comes_back_after_the_last_one_also_after_an_error() -> None:
    with pytest.raises(ValueError), uncollected():  # noqa: PT012
        with uncollected():
            assert not gc.isenabled()
        assert not gc.isenabled()
        raise ValueError
    assert gc.isenabled()


def test_it_stays_off_where_it_was_off() -> None:
    gc.disable()
    with uncollected():
        pass
    assert not gc.isenabled()


def test_it_comes_back_after_the_last_thread() -> None:
    inside, leave = threading.Event(), threading.Event()

    def other() -> None:
        with uncollected():
            inside.set()
            leave.wait(10.0)

    thread = threading.Thread(target=other)
    with uncollected():
        thread.start()
        assert inside.wait(10.0)
    assert not gc.isenabled()
    leave.set()
    thread.join()
    assert gc.isenabled()


def test_compiling_and_tracing_are_without_it() -> None:
    seen = []

    class Seen(tx.Expr):
        takes, gives = ((),), ()
        operand: Operand

        def simplify(self) -> tx.Expr:
            seen.append(("simplified", gc.isenabled()))
            return self

        def evaluate(self, value):  # type: ignore[no-untyped-def]
            seen.append(("evaluated", gc.isenabled()))
            return 2.0 * value

    x = tx.State("x")
    dynamics = tx.compile(tx.System({x: Seen(x)}), backend=tx.XLA())
    assert dynamics(0.0, {"x": 3.0})["x"] == 6.0
    assert {*seen} == {("simplified", False), ("evaluated", False)}
    assert gc.isenabled()
