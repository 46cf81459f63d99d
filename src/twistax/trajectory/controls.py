"""How a control goes on between nodes: `Problem(controls=...)`."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..checks import listed, reals, short
from ..errors import ModelError, ShapeError
from ..expr import Control
from ..system import name_of


@dataclasses.dataclass(frozen=True)
class Held:
    """A control that is constant over each interval, and may jump at nodes."""


@dataclasses.dataclass(frozen=True, eq=False)
class Linear:
    """A control that is continuous, and linear in time over each interval (a first-order hold).

    Its values at nodes are unknowns; boxes hold at both ends of each interval, and so between them. Where the optimal
    control is smooth the optimum of the mesh is off by the fourth power of the intervals, that of held controls by
    the second.

    Args:
        rate: the largest magnitude of its rate, in its unit per s: a number or an array of its shape; None for none.

    Raises:
        ModelError: a rate that is not positive.
    """

    rate: Any = None

    def __post_init__(self) -> None:
        if self.rate is not None and not (reals("Linear: rate", self.rate, ModelError) > 0.0).all():
            raise ModelError(f"Linear: rate expects positive numbers, got {short(self.rate)}")

    def rate_control(self, leaf: Control) -> Control:
        """The held control that is the rate of a linear one."""
        if self.rate is not None and np.ndim(self.rate) and np.shape(self.rate) != leaf.shape:
            raise ShapeError(f"Linear: rate of {leaf.name!r} expects shape {leaf.shape}, got {np.shape(self.rate)}")
        limit = None if self.rate is None else np.abs(np.asarray(self.rate, float))
        return Control(Rate(leaf).name, leaf.shape, min=None if limit is None else -limit, max=limit)


def Rate(control: Any) -> Control:
    """The rate of a linear control, in its unit per s, for running costs and for constraints of the system.

    `running=u**2 + 0.1 * tx.trajectory.Rate(u)**2`, `constraints={"slew": tx.trajectory.Rate(u) <= 3.0}`.

    Raises:
        ModelError: it is not given a control.
    """
    if not isinstance(control, Control):
        raise ModelError(f"Rate expects a control, got {short(control)}")
    return Control(f"rate of {control.name}", control.shape)


def linear_controls(given: Any, controls: Sequence[Control]) -> dict[str, Linear]:
    """Which controls are linear, from `controls=`: one way for all, or a dict by control or name.

    Raises:
        ModelError: an unknown control, another way than Held or Linear, or the rate of a control that is held.
    """
    known = {leaf.name: leaf for leaf in controls}
    rates = {Rate(leaf).name: leaf.name for leaf in controls}
    if not isinstance(given, Mapping):
        given = dict.fromkeys((name for name in known if name not in rates), Held() if given is None else given)
    found = {}
    for key, way in given.items():
        name = name_of(key)
        if name not in known:
            raise ModelError(f"controls names {name!r}; the controls are: {listed(known, name)}")
        if not isinstance(way, (Held, Linear)):
            raise ModelError(f"controls expects tx.trajectory.Held() or Linear(), got {short(way)}")
        if isinstance(way, Linear):
            found[name] = way
    for rate, name in rates.items():
        if rate in known and name not in found:
            raise ModelError(
                f"the system reads the {rate}, which is held.\n  fix: controls={{{name!r}: tx.trajectory.Linear()}}"
            )
    return found
