"""Solutions and scenes put together by hand, for the tests of what draws and shows them."""

from collections.abc import Callable, Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np

import twistax as tx
from twistax.integrators.results.solution import Stats
from twistax.view.motion import Motion, shown


def solution_of(ts: Any, xs: Mapping[str, Any], **fields: Any) -> tx.Solution:
    """A solution of one integration that saved these states (n, ...) by name at these times (n,)."""
    xs = {name: jnp.asarray(value) for name, value in xs.items()}
    fields = {"stats": Stats(*np.ones((4, 1))), "code": np.zeros(1)} | fields
    return tx.Solution(ts=jnp.asarray(ts), xs=xs, **fields)


def scene_of(
    ts: Any, xs: Mapping[str, Any], path: Any = None, outputs: Callable[[], Any] | None = None, **choices: Any
) -> tx.view.Scene:
    """The scene of these states and outputs, as `Solution.show` makes it of its own."""
    return shown(Motion(np.asarray(ts), xs, () if outputs is None else (outputs,)), path, **choices)
