"""Which numbers of a model become Parameters."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from ...checks import listed
from ...errors import ModelError
from ...expr import Parameter


class Choices:
    """Makes Parameters of the numbers that were asked for, and leaves the others.

    Args:
        wanted: True for all, or names.
    """

    def __init__(self, wanted: bool | Iterable[str]) -> None:
        if not isinstance(wanted, bool) and (isinstance(wanted, str) or not isinstance(wanted, Iterable)):
            raise ModelError(f"load expects parameters=True or a list of names, got {wanted!r}")
        self.wanted = wanted if isinstance(wanted, bool) else set(wanted)
        self.known: list[str] = []

    def of(self, owner: str, what: str, value: Any) -> Any:
        """The value, or a Parameter `<owner>_<what>` with it."""
        name = f"{owner}_{what}"
        self.known.append(name)
        chosen = self.wanted if isinstance(self.wanted, bool) else name in self.wanted
        return Parameter(name, value=np.asarray(value, dtype=np.float64)) if chosen else value

    def check(self) -> None:
        """Raise ModelError for a name that the model does not have."""
        for name in sorted(set() if isinstance(self.wanted, bool) else self.wanted - set(self.known)):
            raise ModelError(f"load: the model has no number {name!r}; known are {listed(self.known, name)}")
