"""The problems, a file a source or two."""

from ..statement import Foreign, Phased
from . import (
    acados,
    bocop,
    casadi_examples,
    control_toolbox,
    cops,
    larger,
    psopt,
    psopt_larger,
    psopt_more,
    textbooks,
    vehicles,
)

_MODULES = (
    casadi_examples,
    cops,
    larger,
    bocop,
    control_toolbox,
    psopt,
    psopt_larger,
    psopt_more,
    acados,
    vehicles,
    textbooks,
)

#: By the names that `--only` takes.
FOREIGN: dict[str, Foreign | Phased] = {
    name.lower(): problem
    for module in _MODULES
    for name, problem in vars(module).items()
    if isinstance(problem, (Foreign, Phased))
}
