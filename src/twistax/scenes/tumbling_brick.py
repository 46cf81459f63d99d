"""The tumbling brick of NASA's check-cases, as a scene: case 2, without air."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np

import twistax as tx
from twistax.mechanics.environment import gravity

from . import check_cases
from .scene import Scene

__all__ = ["EARTH", "TUMBLING_BRICK", "Vacuum"]

#: The gravity of the check-cases.
EARTH = gravity.EARTH_J2

_CASE = check_cases.CASES[2]


@dataclasses.dataclass(frozen=True)
class Vacuum:
    """No air, so that a case without damping does not compute any."""

    def density(self, altitude: tx.Expr) -> tx.Expr:
        """0 kg/m3 at every altitude."""
        return tx.Constant(0.0)


# fmt: off
#: As `python -m twistax.scenes.references tumbling-brick` finds it.
_END = {
    "g": np.array(
        [
            [-0.06645269380879221, 0.8274579823515108, -0.5575816773606551, 6382876.25860248],
            [-0.07477293808224801, 0.5531158281661552, 0.8297420613435338, 13969.82325675744],
            [0.9949839431951167, 0.09683061537982218, 0.025115427710109352, -1.660534193586431e-18],
            [0.0, 0.0, 0.0, 1.0],
        ]
    ),
    "V": np.array([-15.284531626242556, 14.407555633037305, 549.9715644397888, 0.22023246534298518,
                   -0.3036432161227343, 0.5431392879442162]),
}
# fmt: on

TUMBLING_BRICK = Scene(
    name="tumbling-brick",
    title="NASA tumbling brick",
    summary=(
        "A brick of 2.3 kg dropped from 9144 m over the equator tumbles for 30 s without air: an Euler top of a few "
        "1e-3 kg m2 at 6.4e6 m from the origin, falling in J2 gravity."
    ),
    source="NASA/TM-2015-218675, atmospheric check-case 2",
    build=functools.partial(check_cases.system, Vacuum()),
    start=_CASE.start(),
    params=_CASE.parameters(),
    duration=check_cases.DURATION,
    reference=_END,
)
