"""The checks of `python -m twistax report --stability`, `--figures` and `--optimal`, in the order of their pages."""

import functools

from ..checks import Checked, Section
from ..foreign import FOREIGN
from . import (
    calls,
    costs,
    edges,
    files,
    flight_limits,
    hessians,
    identities,
    keeping,
    lookups,
    maps,
    mechanisms,
    moving_masses,
    optimal,
    rivals,
    scalars,
    small,
    spoiled,
    statuses,
    steps,
    stiff,
    strategies,
    trust,
)

STABILITY: dict[str, Section] = {
    "stiff": stiff.STIFF,
    "turning": stiff.TURNING,
    "angles": maps.ANGLES,
    "extremes": keeping.EXTREMES,
    "long": keeping.LONG_RUNS,
    "single": maps.PRECISION,
    "events": edges.EVENTS,
    "jumps": edges.JUMPS,
    "inputs": edges.INPUTS,
    "failures": edges.FAILURES,
    "flight": flight_limits.FLIGHT,
    "statuses": statuses.STATUSES,
    "spoiled": spoiled.SPOILED,
    "masses": moving_masses.MOVING_MASSES,
    "loops": moving_masses.LOOPS,
    "files": files.FILES,
}

FIGURES: dict[str, Section] = {
    "identities": identities.IDENTITIES,
    "keeping": keeping.KEEPING,
    "maps": maps.LAST_PLACES,
    "linearisation": steps.LINEARISATION,
    "stiffness": stiff.STIFFNESS,
    "long": keeping.LONG,
    "races": costs.RACES,
    "bridge": steps.BRIDGE,
    "costs": costs.COSTS,
    "steps": steps.STEPS,
    "beside": steps.BESIDE,
    "calls": calls.CALLS,
    "lookups": lookups.LOOKUPS,
    "gradients": steps.GRADIENTS,
    "operations": scalars.OPERATIONS,
    "hessians": hessians.HESSIANS,
    "kernels": scalars.KERNELS,
    "small": small.SMALL,
    "mechanisms": mechanisms.MECHANISMS,
    "landings": costs.LANDINGS,
    "optima": optimal.OPTIMA,
}

OPTIMAL: dict[str, Section] = {
    "published": optimal.PUBLISHED,
    "refined": optimal.REFINED,
    "trust": trust.TRUST,
    "solvers": optimal.SOLVERS,
    "ratios": optimal.RATIOS,
    "openscvx": rivals.OPENSCVX,
    "times": optimal.TIMES,
    "strategies": strategies.STRATEGIES,
}

#: Names that `--only` takes.
EVERY = [*FIGURES, *STABILITY, *OPTIMAL, *FOREIGN]
stability = functools.partial(Checked, "stability", STABILITY)
figures = functools.partial(Checked, "figures", FIGURES)
optimal_control = functools.partial(Checked, "optimal", OPTIMAL)
