"""Problems of fixed durations, to begin with where free ones lead a run astray.

While durations are free a step may shorten what it should steer: a mass that moves away from where it is to stop comes
nearest at once. At a fixed duration that is long enough there is no such point of rest.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..transcription.border import Border
from ..transcription.points import Given, Point

#: How many times as long as at the start, and how near to these durations a trajectory is to stay.
_FACTORS, _NEAR = (3.0, 9.0, 1.0), 0.01
#: Of the way up to its limit a duration goes no further than this.
_MOST = 0.9


def fixed(border: Border, start: Point, given: Given) -> Iterator[tuple[Point, Given]]:
    """Starts with other durations, and the problem with these as limits; nothing where no duration is free."""
    limits, begun = np.array(given.limits), np.asarray(start.border)
    low, high = limits.T
    free = border.free & (np.arange(border.size) < border.phases) & (low < high)
    before = [begun]
    for factor in _FACTORS if free.any() else ():
        with np.errstate(invalid="ignore"):  # parameters may have no limits
            times = np.where(free, np.clip(factor * begun, low, low + _MOST * (high - low)), begun)
        if factor != 1.0 and any(np.allclose(times[free], earlier[free], rtol=0.1, atol=0.0) for earlier in before):
            continue
        before.append(times)
        near = np.stack([np.maximum(low, (1.0 - _NEAR) * times), np.minimum(high, (1.0 + _NEAR) * times)], axis=1)
        yield start._replace(border=times), given._replace(limits=np.where(free[:, None], near, limits))
