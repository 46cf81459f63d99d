"""The table of primitives, family by family: an entry says all that this package knows of a primitive of JAX.

What is not in it, or has parameters that its entry does not know, stays a call of JAX, with the same numbers.
"""

from __future__ import annotations

from typing import Any

from ....jax_inside import Unread, say_once
from ..entry import Entry, convert
from .arithmetic import CONTRACTION, ELEMENTWISE, LINEAR_ALGEBRA
from .control import CONTROL
from .movement import INDEXING, MOVEMENT
from .operations import OPERATIONS

__all__ = ["OPERATIONS", "TABLE", "convert", "entry_of", "say_unread"]

#: By the name of the primitive.
TABLE: dict[str, Entry] = {
    **OPERATIONS,
    **{e.name: e for e in (*ELEMENTWISE, *MOVEMENT, *INDEXING, *CONTRACTION, *LINEAR_ALGEBRA, *CONTROL)},
}


def entry_of(eqn: Any) -> Entry | None:
    """The entry of an equation; None where there is none, or where it does not understand all parameters.

    One warning for names of parameters that it does not know.
    """
    entry = TABLE.get(eqn.primitive.name)
    try:
        return entry if entry is not None and entry.understands(eqn) else None
    except Unread as error:
        say_unread(error)
        return None


def say_unread(error: Unread) -> None:
    """Tell the user, once, that an operation stays a call of JAX."""
    say_once(f"{error}, which this twistax does not know: that operation runs as JAX has it")
