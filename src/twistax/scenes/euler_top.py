"""The Euler top: three different moments of inertia, no torque."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from . import spinning_body
from .arrays import about
from .free_rotation import TriaxialBody
from .scene import Scene

__all__ = ["EULER_TOP"]

_BODY = TriaxialBody(np.array([1.0, 2.0, 3.0]), about((1.0, 0.0, 0.0), 0.6), np.array([2.0, 0.0, 1.5]))


def _exact(t: float) -> dict[str, Any]:
    return dict(zip(("R", "w"), _BODY.at(t)))


EULER_TOP = Scene(
    name="euler-top",
    title="Euler top",
    summary=(
        "A free body with moments 1, 2 and 3 kg m2 tumbles for 20 s: the angular velocity changes direction and size "
        "all the time, so that no two steps commute."
    ),
    source="Landau and Lifshitz, Mechanics, section 37",
    build=functools.partial(spinning_body.system, tuple(_BODY.inertia)),
    start={"R": _BODY.rotation, "w": _BODY.rate},
    duration=20.0,
    exact=_exact,
    invariants=("energy", "momentum"),
)
