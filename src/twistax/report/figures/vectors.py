"""Forward dynamics of a Panda and their Jacobian in native kernels, compared with C in scalars and in vectors of
eight.
"""

import functools

import numpy as np

from ...trajectory.strategy.batch import processors
from ..harness.expected import Absent, at_most, between
from ..harness.measurement import Section, slow
from ..harness.timing import Race, Repeats, Timed
from ..speed.cases import CASES
from ..speed.contenders import JACOBIAN, NATIVE, NATIVE_ALONE, VALUE, DerivativeKind, values
from ..speed.peers import CASADI, CASADI_LANES, LANES, in_c

#: Points at once.
_BATCH = 4096
_CASE = CASES["aba-7"]


def programs(quantity: DerivativeKind) -> dict[str, Timed]:
    """C in scalars and in vectors, and kernels, on one core and on all."""
    if why := CASADI.absent() or NATIVE.absent():
        raise Absent(f"not run: {why}")
    threads = in_c("", "", LANES, processors())
    alone, together = (it.task(_CASE, quantity) for it in (NATIVE_ALONE, NATIVE))
    return {
        "C": CASADI.task(_CASE, quantity).batch(_BATCH),
        "C in vectors": CASADI_LANES.task(_CASE, quantity).batch(_BATCH),
        "C in vectors and threads": threads.task(_CASE, quantity).batch(_BATCH),
        "ours": alone.in_place(_BATCH),
        "ours in threads": together.in_place(_BATCH),
        "ours in new memory": alone.batch(_BATCH),
    }


def _section(what: str, quantity: DerivativeKind, bar: float) -> Section:
    def read(result: object) -> np.ndarray:
        entries = values(Timed(lambda: result))
        return entries / np.abs(entries).max()

    race = Race(functools.partial(programs, quantity), 1e-9, Repeats(31, 15), read)
    return [
        slow(f"{what}: an evaluation", "C in scalars, one core", between(unit="ns"), race.seconds, "C", 1e-9),
        slow(
            f"{what}: an evaluation", "C in vectors, one core", between(unit="ns"), race.seconds, "C in vectors", 1e-9
        ),
        slow(f"{what}: an evaluation", "a kernel, one core", between(unit="ns"), race.seconds, "ours", 1e-9),
        slow(f"{what}: a kernel", "over C in vectors, one core", at_most(bar), race.ratio, "ours", "C in vectors"),
        slow(
            f"{what}: a kernel that writes into new memory",
            "over C in vectors, one core",
            between(),
            race.ratio,
            "ours in new memory",
            "C in vectors",
        ),
        slow(
            f"{what}: a kernel",
            "over C in vectors, both on all cores",
            between(),
            race.ratio,
            "ours in threads",
            "C in vectors and threads",
        ),
    ]


VECTORS: Section = [*_section("ABA", VALUE, 0.6), *_section("Jacobian of ABA", JACOBIAN, 0.9)]
