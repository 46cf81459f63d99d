"""A jaxpr of small arrays, equation by equation, as instructions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ....jax_inside import ClosedJaxpr, Jaxpr, Literal, part
from ...scalar.graph import TooLarge
from ...scalar.primitive import Derived
from ...scalar.program import scalarize
from ...scalar.table import TABLE, entry_of
from ..code import Module, NotNative
from ..tile import NATIVE_LIMITS, native_form
from . import elementwise
from .control import CALLS, CONTROL
from .elementwise import Groups, Pending
from .entries import of_entries
from .memory import View, known, native_type
from .moves import MOVES
from .products import PRODUCTS
from .reductions import REDUCTIONS
from .sweep import ArrayCode

#: The most entries of arrays that are looked at one by one.
_MOST = 20_000

#: What needs arrays that are computed.
_READY = {**MOVES, **PRODUCTS, **REDUCTIONS}


class Reading:
    """Adds the instructions of jaxprs.

    Attributes:
        code: where they go.
    """

    def __init__(self, module: Module) -> None:
        self.code = ArrayCode(module)
        self._groups = Groups(self.code)
        self._reading: list[Jaxpr] = []

    def read(self, program: ClosedJaxpr, arguments: Sequence[View]) -> list[View]:
        """The results of a jaxpr; all of them are computed.

        Raises:
            NotNative: something in it has no native form.
        """
        found = [self._groups.view(value) for value in self._values(program, arguments)]
        self._groups.compute()
        return found

    def replaced(self, state: Sequence[View], values: Sequence[View]) -> None:
        """Write the values of the next turn where those of this one lie, of which they may be views."""
        places = {id(own.place): k for k, own in enumerate(state)}
        ready = list[View | None]()
        for k, value in enumerate(values):
            source = None if value.place is None else places.get(id(value.place))
            same = source == k and value.base == state[k].base and value.offset == state[k].offset
            same = same and value.array.strides == state[k].array.strides
            ready.append(None if same else value if source is None else self.code.copied(value))
        for own, moved in zip(state, ready, strict=True):
            if moved is not None:
                self.code.copied(moved, own)

    def kernel(self, program: Derived, single: bool) -> Any:
        """The kernel of a program.

        Raises:
            NotNative: there is none.
        """
        found = program.native(single)
        if found is None:
            raise NotNative("a program in it has no native form")
        self.code.kernels.append(found)
        return found

    def by_entries(self, eqn: Any, arrays: Sequence[View]) -> list[View]:
        """The results of an equation entry by entry.

        Raises:
            NotNative: it has no such form, or computes too many entries.
        """
        views = {v: a for v, a in zip(eqn.invars, arrays, strict=True) if not isinstance(v, Literal)}
        numbers = {v: a.array for v, a in views.items() if a.known}
        sources = {v: a for v, a in views.items() if not a.known}
        if sum(v.aval.size for v in (*sources, *eqn.outvars)) > _MOST:
            raise NotNative(f"{eqn.primitive.name} of so many entries has no native form")
        closed = part(self._reading[-1], [eqn], list(sources), eqn.outvars, numbers)
        try:
            form = native_form(scalarize(closed, checked=True, limits=NATIVE_LIMITS))
        except TooLarge as error:
            raise NotNative(str(error).splitlines()[0]) from error
        return of_entries(self.code, form, list(sources.values()))

    def _values(self, program: ClosedJaxpr, arguments: Sequence[View | Pending]) -> list[View | Pending]:
        """The same, computed when they are needed."""
        jaxpr = program.jaxpr
        values: dict[Any, View | Pending] = {}

        def value(variable: Any) -> View | Pending:
            if isinstance(variable, Literal):
                aval: Any = variable.aval
                return known(np.asarray(variable.val, aval.dtype))
            return values[variable]

        # The equation that reads a variable last; none for what nobody needs.
        last = {v: len(jaxpr.eqns) for v in jaxpr.outvars if not isinstance(v, Literal)}
        for k in reversed(range(len(jaxpr.eqns))):
            if any(v in last for v in jaxpr.eqns[k].outvars):
                for v in jaxpr.eqns[k].invars:
                    if not isinstance(v, Literal):
                        last.setdefault(v, k)
        for v in jaxpr.constvars:
            native_type(v)
        values.update((v, known(np.asarray(c))) for v, c in zip(jaxpr.constvars, program.consts, strict=True))
        values.update(zip(jaxpr.invars, arguments, strict=True))
        del arguments
        self._reading.append(jaxpr)
        for k, eqn in enumerate(jaxpr.eqns):
            if not any(v in last for v in eqn.outvars):
                continue
            for v in eqn.outvars:
                native_type(v)
            own = [value(v) for v in eqn.invars]
            for v in eqn.invars:
                if not isinstance(v, Literal) and last[v] == k:
                    values.pop(v, None)
            found = self._equation(eqn, own)
            del own
            values.update((v, a) for v, a in zip(eqn.outvars, found, strict=True) if v in last)
        self._reading.pop()
        return [value(v) for v in jaxpr.outvars]

    def _equation(self, eqn: Any, arguments: list[View | Pending]) -> Sequence[View | Pending]:
        name, entry = eqn.primitive.name, entry_of(eqn)
        if entry is None and name in TABLE:
            raise NotNative(f"{name} has parameters that have no native form")
        if entry is not None and name in elementwise.NAMES:
            return self._groups.add(entry, eqn, arguments)
        if name in CALLS:
            inner, given = CALLS[name](eqn, list(arguments))
            arguments.clear()
            return self._values(inner, given)
        views = [self._groups.view(own) for own in arguments]
        arguments.clear()
        if name in CONTROL:
            self._groups.compute()
            return CONTROL[name](self, eqn, *views)
        if name in _READY:
            found = _READY[name](self, eqn, *views)
            return found if isinstance(found, list) else [found]
        return self.by_entries(eqn, views)
