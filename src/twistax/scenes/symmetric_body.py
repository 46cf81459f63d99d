"""Two free bodies with an axis of symmetry: one that wobbles, and one that spins a hundred and sixty times a second."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from . import spinning_body
from .arrays import about
from .free_rotation import SymmetricBody
from .scene import Scene

__all__ = ["FAST_SPIN", "SYMMETRIC_BODY"]


def _scene(body: SymmetricBody, **said: Any) -> Scene:
    def exact(t: float) -> dict[str, Any]:
        return dict(zip(("R", "w"), body.at(t)))

    return Scene(
        source="Landau and Lifshitz, Mechanics, section 33",
        build=functools.partial(spinning_body.system, (body.transverse, body.transverse, body.axial)),
        start={"R": body.rotation, "w": body.rate},
        exact=exact,
        invariants=("energy", "momentum"),
        **said,
    )


SYMMETRIC_BODY = _scene(
    SymmetricBody(1.0, 1.5, about((1.0, 0.0, 0.0), 0.6), np.array([0.6, -0.4, 3.0])),
    name="symmetric-body",
    title="free symmetric body",
    summary=(
        "A free body with moments 1, 1 and 1.5 kg m2 spins at 3 rad/s and wobbles for 20 s: precession and spin are "
        "both steady, so that the phase of each shows every error."
    ),
    duration=20.0,
)

#: A relative error of 1e-16 in the angular velocity is an angle of 1e-12 rad at the end.
FAST_SPIN = _scene(
    SymmetricBody(1.0, 1.5, about((1.0, 0.0, 0.0), 0.6), np.array([10.0, 0.0, 1000.0])),
    name="fast-spin",
    title="fast spin",
    summary=(
        "A free body with moments 1, 1 and 1.5 kg m2 spins at 1000 rad/s for 10 s: it turns by 1.5e4 rad about its "
        "momentum, and round-off in the rate alone is worth some 1e-12 rad of attitude."
    ),
    duration=10.0,
)
