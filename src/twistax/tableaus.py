"""Butcher tableaus: `tx.tableaus.RK4` and others, listed in `tx.tableaus.ALL`; a custom one is a `ButcherTableau`.

`IMPLICIT` lists those of implicit methods, for `tx.ImplicitRKMK`; a custom one is a `CollocationTableau`. `CF4` is a
commutator-free tableau, for `tx.CommutatorFree`; a custom one is a `CommutatorFreeTableau`.
"""

from .integrators.methods.commutator_free import CF4, CommutatorFreeTableau
from .integrators.tableaus import *  # noqa: F403
from .integrators.tableaus import __all__ as _tableaus

__all__ = [*_tableaus, "CF4", "CommutatorFreeTableau"]
