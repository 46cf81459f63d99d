"""Problems with known optima on meshes that are refined, with linear controls, or with free node times."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

import twistax as tx

from ...trajectory import Linear, Mesh, Problem, TrajectoryResult
from ..checks import Check, Section, at_most, between
from .optima import goddard
from .optimal import brachistochrone, bryson_denham, cart_pole, landing, reorientation

#: What is asked of a refinement.
_TOLERANCE = 1e-6

#: The half turn of Bilimoria and Wie with five switches, all torques at limits: its arcs take a, b, a, a, b, a s, which
#: is 3.2430833 s. Published are 3.24307 s, with a last digit that is not met.
FIVE_SWITCHES = (0.44543899494481, 0.73066364883654)


def _hypersensitive() -> Problem:
    """x' = u - x^3 from 1.5 to 1 in 40 s at least (x^2 + u^2) / 2. Source: Rao and Mease, Automatica 35 (1999).

    Over so long a time it rests at zero in between, where H = 0 says u = x^3 -+ sqrt(x^6 + x^2) for both ends; so the
    optimum is the integral of sqrt(x^6 + x^2) - x^3 up to 1.5 and of sqrt(x^6 + x^2) + x^3 up to 1.
    """
    x, u = tx.State("x"), tx.Control("u")
    return Problem(
        tx.compile(tx.System(rates={x: u - x**3})),
        tx.Minimize(running=0.5 * (x**2 + u**2)),
        nodes=41,
        final_time=40.0,
        initial={x: 1.5},
        final={x: 1.0},
        controls=Linear(),
    )


@dataclasses.dataclass(frozen=True)
class Known:
    """A problem, its optimum, how near to it the refined mesh is asked to come, and options of the solve."""

    make: Callable[[], Problem]
    optimum: float
    bar: float
    options: Mapping[str, Any] = dataclasses.field(default_factory=dict)


def _of(make: Callable[..., Problem], **options: Any) -> Callable[[], Problem]:
    return functools.partial(make, **options)


#: Bars are 1e-6, or half of the last digit that is published.
KNOWN: dict[str, Known] = {
    "brachistochrone, linear: 1.801603": Known(_of(brachistochrone, nodes=13, controls=Linear()), 1.801603122, 1e-6),
    "Bryson-Denham, linear: exactly 4": Known(_of(bryson_denham, nodes=16, controls=Linear()), 4.0, 1e-6),
    "Goddard, held: 1.01284": Known(goddard, 1.01284, 5e-6),
    "cart-pole of Kelly, linear: 58.8077": Known(_of(cart_pole, nodes=26, controls=Linear()), 58.8077, 1e-6),
    "half turn of Bilimoria and Wie, free node times: 3.2430833 s": Known(
        _of(reorientation, nodes=Mesh(7, free=True), substeps=8),
        4.0 * FIVE_SWITCHES[0] + 2.0 * FIVE_SWITCHES[1],
        1e-6,
        {"guesses": 8},
    ),
    "hypersensitive, linear: 1.330807": Known(_hypersensitive, 1.3308069049430025, 1e-6),
    "landing of the demo, held, limits kept between nodes": Known(
        landing, 27_260.0, 1e-3, {"refine": 1e-5, "between": 1e-4}
    ),
}


@functools.cache
def _result(name: str) -> TrajectoryResult:
    known = KNOWN[name]
    return known.make().solve(**{"refine": _TOLERANCE, **known.options})


def _apart(name: str) -> float:
    """The relative difference from the optimum; NaN unless SOLVED."""
    result = _result(name)
    return abs(result.cost / KNOWN[name].optimum - 1.0) if result.solved else math.nan


def _beyond(name: str) -> float:
    return max(_result(name).between_nodes.values(), default=0.0)


REFINED: Section = [
    check
    for name, known in KNOWN.items()
    for check in (
        Check(name, "apart", at_most(known.bar), _apart, name, slow=True),
        Check(name, "meshes", between(), lambda n=name: float(len(_result(n).meshes)), slow=True),
        Check(name, "nodes of the last", between(), lambda n=name: float(_result(n).meshes[-1].nodes), slow=True),
        Check(
            name,
            "largest error of an interval",
            at_most(known.options.get("refine", _TOLERANCE)),
            lambda n=name: _error(n),
            slow=True,
        ),
        Check(name, "beyond limits between nodes", between(), _beyond, name, slow=True),
    )
]


def _error(name: str) -> float:
    return float(np.max(_result(name).meshes[-1].error))
