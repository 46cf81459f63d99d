"""The problems, a file a source or two."""

from ..statement import Foreign
from . import (
    acados,
    bocop,
    casadi_examples,
    control_toolbox,
    cops,
    psopt,
    psopt_larger,
    psopt_more,
    textbooks,
    vehicles,
)

_MODULES = (
    casadi_examples,
    cops,
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
FOREIGN: dict[str, Foreign] = {
    name.lower(): problem
    for module in _MODULES
    for name, problem in vars(module).items()
    if isinstance(problem, Foreign)
}
