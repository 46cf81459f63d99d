"""How far an integration is, told while it runs. Where nobody asks, nothing of it is in the program."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from ...checks import short
from ...errors import InputError
from ...progress import Progress

Now = TypeVar("Now")
#: Called with the time that was reached, and the share of the way to the end.
Told = Callable[[float, float], Any]

#: Who asked, while their integrations run: the programs, which are kept, know the number alone.
_ASKED: dict[int, tuple[Told, list[Exception]]] = {}
_NUMBERS = itertools.count()


def _tell(number: Any, t: Any, share: Any) -> None:
    callback, raised = _ASKED.get(int(number), (None, []))
    if callback is None or raised:
        return
    try:
        callback(float(t), float(share))
    except Exception as error:
        raised.append(error)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Meter:
    """What a loop over steps tells: a pytree, so that another one who asks compiles nothing anew."""

    number: Any

    def along(
        self,
        steps_to: Callable[[Now, jax.Array], Now],
        now: Now,
        stop: jax.Array,
        part: jax.Array,
        at: Callable[[Now], tuple[jax.Array, jax.Array, jax.Array]],
    ) -> Now:
        """steps_to(now, stop) in parts of some steps, with a word after each.

        Args:
            at: of what is carried the number of steps, the time, and the share of the way to the end; the number is
                `stop` or more where it halted.
        """

        def one(now: Now) -> Now:
            now = steps_to(now, jnp.minimum(stop, at(now)[0] + part))
            jax.debug.callback(_tell, self.number, *at(now)[1:])
            return now

        return jax.lax.while_loop(lambda now: at(now)[0] < stop, one, now)


def asked_for(progress: Any) -> Told | None:
    """What `progress` of `integrate` asks for. Raises InputError."""
    if progress is False:
        return None
    if progress is True:
        return Progress("integrate").reached
    if callable(progress):
        return progress
    raise InputError(
        f"progress expects True, or a function of the time reached and the share of the way, got {short(progress)}"
    )


@contextlib.contextmanager
def metered(callback: Told) -> Iterator[Meter]:
    """A meter for the loops inside. What the function raised is raised at the end."""
    number, raised = next(_NUMBERS), list[Exception]()
    _ASKED[number] = callback, raised
    try:
        yield Meter(np.asarray(number))
        jax.effects_barrier()
    finally:
        del _ASKED[number]
        line = getattr(callback, "__self__", None)
        if isinstance(line, Progress):  # an event may have ended it on the way
            line.close()
    if raised:
        raise raised[0]
