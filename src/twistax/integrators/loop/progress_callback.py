"""Calls of a progress callback during an integration. Without a callback, programs contain no trace of it."""

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
#: Called with the time that was reached, and the completed fraction to the end.
ProgressCallback = Callable[[float, float], Any]

#: The callbacks of running integrations by number: compiled programs, which are cached, hold only the number.
_CALLBACKS: dict[int, tuple[ProgressCallback, list[Exception]]] = {}
_NUMBERS = itertools.count()


def _call_back(number: Any, t: Any, share: Any) -> None:
    callback, raised = _CALLBACKS.get(int(number), (None, []))
    if callback is None or raised:
        return
    try:
        callback(float(t), float(share))
    except Exception as error:
        raised.append(error)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class ProgressCalls:
    """Calls the progress callback in a loop over steps. A pytree: another callback does not recompile."""

    number: Any

    def loop(
        self,
        steps_to: Callable[[Now, jax.Array], Now],
        now: Now,
        stop: jax.Array,
        part: jax.Array,
        at: Callable[[Now], tuple[jax.Array, jax.Array, jax.Array]],
    ) -> Now:
        """steps_to(now, stop) in parts of some steps, with a call of the callback after each.

        Args:
            at: a function from the carry to the number of steps, the time, and the completed fraction of the span; the
                number is at least `stop` if the loop halted.
        """

        def one(now: Now) -> Now:
            now = steps_to(now, jnp.minimum(stop, at(now)[0] + part))
            jax.debug.callback(_call_back, self.number, *at(now)[1:])
            return now

        return jax.lax.while_loop(lambda now: at(now)[0] < stop, one, now)


def callback_of(progress: Any) -> ProgressCallback | None:
    """The callback for the argument `progress` of `integrate`. Raises InputError."""
    if progress is False:
        return None
    if progress is True:
        return Progress("integrate").reached
    if callable(progress):
        return progress
    raise InputError(
        f"progress expects True, or a function of the time reached and the completed fraction, got {short(progress)}"
    )


@contextlib.contextmanager
def calling_back(callback: ProgressCallback) -> Iterator[ProgressCalls]:
    """A context in which loops call the progress callback. An exception of the callback is raised at the end."""
    number, raised, line = next(_NUMBERS), list[Exception](), getattr(callback, "__self__", None)
    _CALLBACKS[number] = callback, raised
    try:
        with line if isinstance(line, Progress) else contextlib.nullcontext():  # its line is cleared at the end
            yield ProgressCalls(np.asarray(number))
            jax.effects_barrier()
    finally:
        del _CALLBACKS[number]
    if raised:
        raise raised[0]
