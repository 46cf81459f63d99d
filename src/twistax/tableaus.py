"""Butcher tableaus: `tx.tableaus.RK4` and the others, `tx.tableaus.ALL`; make your own with `ButcherTableau`.

`IMPLICIT` lists those of implicit methods, for `tx.ImplicitRKMK`; make your own with `CollocationTableau`.
`CF4` is the commutator-free one, for `tx.CommutatorFree`; make your own with `CommutatorFreeTableau`.
"""

from .integrators.methods.commutator_free import CF4, CommutatorFreeTableau
from .integrators.tableaus import *  # noqa: F403
from .integrators.tableaus import __all__ as _tableaus

__all__ = [*_tableaus, "CF4", "CommutatorFreeTableau"]
