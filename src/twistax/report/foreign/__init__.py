"""Problems of others, as their authors state them, by plain IPOPT in CasADi and by this package."""

import functools

from . import bocop, casadi_examples, control_toolbox, cops, psopt, psopt_larger
from .page import Beside
from .statement import Foreign

_MODULES = (casadi_examples, cops, bocop, control_toolbox, psopt, psopt_larger)

#: By the names that `--only` takes.
FOREIGN: dict[str, Foreign] = {
    name.lower(): problem
    for module in _MODULES
    for name, problem in vars(module).items()
    if isinstance(problem, Foreign)
}
foreign = functools.partial(Beside, FOREIGN)
