"""The sections of `python -m twistax report --stability`, `--figures` and `--optimal`, in the order of their pages."""

import functools

from .figures import (
    calls,
    costs,
    defaults,
    derivatives,
    filters,
    hessians,
    identities,
    larger_matrices,
    lookups,
    scalars,
    small_matrices,
    steps,
    vectors,
)
from .figures.robots import distances, mechanisms, tasks
from .foreign import FOREIGN
from .harness.measurement import Section
from .harness.report import SectionReport
from .sections import latencies, openscvx, optimal, other_controllers, strategies, trust
from .stability import (
    events,
    failures,
    files,
    flight_limits,
    invariants,
    lie_maps,
    moving_masses,
    robustness,
    statuses,
    stiff,
)

STABILITY: dict[str, Section] = {
    "stiff": stiff.STIFF,
    "turning": stiff.TURNING,
    "angles": lie_maps.ANGLES,
    "extremes": invariants.EXTREMES,
    "long": invariants.LONG_RUNS,
    "single": lie_maps.PRECISION,
    "events": events.EVENTS,
    "jumps": events.JUMPS,
    "inputs": failures.INPUTS,
    "failures": failures.FAILURES,
    "flight": flight_limits.FLIGHT,
    "statuses": statuses.STATUSES,
    "spoiled": robustness.SPOILED,
    "masses": moving_masses.MOVING_MASSES,
    "loops": moving_masses.LOOPS,
    "files": files.FILES,
}

FIGURES: dict[str, Section] = {
    "identities": identities.IDENTITIES,
    "keeping": invariants.KEEPING,
    "maps": lie_maps.LAST_PLACES,
    "linearisation": derivatives.LINEARISATION,
    "stiffness": stiff.STIFFNESS,
    "long": invariants.LONG,
    "races": costs.RACES,
    "bridge": steps.BRIDGE,
    "costs": costs.COSTS,
    "steps": steps.STEPS,
    "beside": steps.BESIDE,
    "calls": calls.CALLS,
    "lookups": lookups.LOOKUPS,
    "gradients": derivatives.GRADIENTS,
    "filters": filters.FILTERS,
    "operations": scalars.OPERATIONS,
    "hessians": hessians.HESSIANS,
    "vectors": vectors.VECTORS,
    "kernels": scalars.KERNELS,
    "small": small_matrices.SMALL,
    "defaults": defaults.DEFAULTS,
    "larger": larger_matrices.LARGER,
    "mechanisms": mechanisms.MECHANISMS,
    "distances": distances.DISTANCES,
    "robots": tasks.ROBOTS,
    "landings": costs.LANDINGS,
    "optima": optimal.OPTIMA,
}

OPTIMAL: dict[str, Section] = {
    "published": optimal.PUBLISHED,
    "refined": optimal.REFINED,
    "trust": trust.TRUST,
    "solvers": optimal.SOLVERS,
    "ratios": optimal.RATIOS,
    "openscvx": openscvx.OPENSCVX,
    "times": optimal.TIMES,
    "latencies": latencies.LATENCIES,
    "controllers": other_controllers.OTHER_CONTROLLERS,
    "strategies": strategies.STRATEGIES,
}

#: Names that `--only` takes.
EVERY = [*FIGURES, *STABILITY, *OPTIMAL, *FOREIGN]
stability = functools.partial(SectionReport, "stability", STABILITY)
figures = functools.partial(SectionReport, "figures", FIGURES)
optimal_control = functools.partial(SectionReport, "optimal", OPTIMAL)
