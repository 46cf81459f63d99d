"""Parametrisations of controls between nodes: `Problem(controls=...)`."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ...checks import listed, reals, short, whole
from ...errors import ModelError, ShapeError
from ...expr import Control, State
from ...system import name_of

#: The prefix of the name of a control's rate.
_RATE_OF = "rate of "


@dataclasses.dataclass(frozen=True)
class Held:
    """A control that is constant over each interval and may jump at the nodes (a zero-order hold)."""


@dataclasses.dataclass(frozen=True, eq=False)
class Spline:
    """A control that is a polynomial in time over each interval, continuous with all derivatives but the last.

    Its values and derivatives at nodes are unknowns; the last derivative is constant over each interval. If the optimal
    control is smooth and the order of the transcription is high enough, the error of the optimum is of order 2 (degree
    + 1) in the interval length. Bounds are imposed at the ends of substeps; `solve(between=...)` also enforces them
    between these points.

    Args:
        degree: of the polynomials, 2 or more; `Linear` is degree 1, `Held` degree 0.
        rate: the largest magnitude of its rate, in its unit per s: a number or an array of its shape. None means no
            limit.

    Raises:
        ModelError: a degree that is not a whole number of 2 or more; a rate that is not positive.
    """

    degree: Any = 3
    rate: Any = None

    def __post_init__(self) -> None:
        name = type(self).__name__
        whole(f"{name}: degree", self.degree, 1 if isinstance(self, Linear) else 2, ModelError)
        if self.rate is not None and not (reals(f"{name}: rate", self.rate, ModelError) > 0.0).all():
            raise ModelError(f"{name}: rate expects positive numbers, got {short(self.rate)}")

    def leaves(self, leaf: Control) -> tuple[list[State], Control]:
        """A chain of states for the control and its derivatives, and a held control for the last derivative."""
        if self.rate is not None and np.ndim(self.rate) and np.shape(self.rate) != leaf.shape:
            name = type(self).__name__
            raise ShapeError(f"{name}: rate of {leaf.name!r} expects shape {leaf.shape}, got {np.shape(self.rate)}")
        limit = None if self.rate is None else np.abs(np.asarray(self.rate, float))
        box = {} if limit is None else {"min": -limit, "max": limit}
        states = [State(leaf.name, leaf.shape, min=leaf.min, max=leaf.max, guess=leaf.guess, scale=leaf.scale)]
        rate = Rate(leaf)
        for order in range(1, self.degree):
            states.append(State(rate.name, leaf.shape, **(box if order == 1 else {})))
            rate = Rate(rate)
        return states, Control(rate.name, leaf.shape, **(box if self.degree == 1 else {}))


@dataclasses.dataclass(frozen=True, eq=False)
class Linear(Spline):
    """A control that is continuous, and linear in time over each interval (a first-order hold).

    Its values at the nodes are unknowns. Bounds hold at both ends of each interval, and therefore in between. If the
    optimal control is smooth, the error of the optimum is of order 4 in the interval length; with piecewise constant
    controls it is of order 2.

    Args:
        rate: the largest magnitude of its rate, in its unit per s: a number or an array of its shape. None means no
            limit.

    Raises:
        ModelError: a rate that is not positive.
    """

    degree: Any = dataclasses.field(default=1, init=False)


def Rate(control: Any) -> Control:
    """The rate of a continuous control, in its unit per s, for running costs and for constraints of the system.

    `running=u**2 + 0.1 * tx.trajectory.Rate(u)**2`, `constraints={"slew": tx.trajectory.Rate(u) <= 3.0}`. A `Spline`
    also has higher derivatives, `Rate(Rate(u))`.

    Raises:
        ModelError: the argument is not a control.
    """
    if not isinstance(control, Control):
        raise ModelError(f"Rate expects a control, got {short(control)}")
    return Control(rate_name(control.name), control.shape)


def rate_name(name: str) -> str:
    """The name of the rate of a control."""
    return f"{_RATE_OF}{name}"


def rates_among(controls: Sequence[Control]) -> dict[str, tuple[str, int]]:
    """Name of a rate among controls -> the name of the control that is differentiated, and the
    order of the derivative.
    """
    known, rates = {leaf.name for leaf in controls}, {}
    for name in known:
        inner, order = name, 0
        while inner.startswith(_RATE_OF):
            inner, order = inner.removeprefix(_RATE_OF), order + 1
            if inner in known:
                rates[name] = inner, order
    return rates


def is_rate(leaf: Any, controls: Sequence[Control]) -> bool:
    """Whether a leaf is a rate of one of the controls."""
    return isinstance(leaf, Control) and leaf.name in rates_among([*controls, leaf])


def continuous_controls(interpolations: Any, controls: Sequence[Control]) -> dict[str, Spline]:
    """The interpolation of each continuous control, from `controls=`: one for all controls, or a dict by control or
    name.

    Raises:
        ModelError: an unknown control; an interpolation other than Held, Linear or Spline; the rate of a control
            without one.
    """
    known = {leaf.name: leaf for leaf in controls}
    rates = rates_among(controls)
    if not isinstance(interpolations, Mapping):
        interpolations = dict.fromkeys(
            (name for name in known if name not in rates), Held() if interpolations is None else interpolations
        )
    splines = {}
    for key, interpolation in interpolations.items():
        name = name_of(key)
        if name not in known:
            raise ModelError(f"controls names {name!r}; the controls are: {listed(known, name)}")
        if not isinstance(interpolation, (Held, Spline)):
            raise ModelError(f"controls expects tx.trajectory.Held(), Linear() or Spline(), got {short(interpolation)}")
        if isinstance(interpolation, Spline):
            splines[name] = interpolation
    for rate, (name, order) in rates.items():
        if name not in splines:
            raise ModelError(
                f"the system reads the {rate}, but the control is piecewise constant (held).\n"
                f"  fix: controls={{{name!r}: tx.trajectory.Linear()}}"
            )
        if order > splines[name].degree:
            raise ModelError(
                f"the system reads the {rate}, which a spline of degree {splines[name].degree} does not have.\n"
                f"  fix: controls={{{name!r}: tx.trajectory.Spline({order})}}"
            )
    return splines
