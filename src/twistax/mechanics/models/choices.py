"""Which numbers of a model become Parameters."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from ...checks import listed
from ...errors import ModelError, TwistaxError
from ...expr import Parameter
from ...expr.lie import Pose
from ..arguments import matrix
from ..bodies import SpatialInertia
from .xml_file import Element


class Choices:
    """Makes Parameters of the numbers that were asked for, and leaves the others.

    Args:
        wanted: True for all, or names.
        physical: refuse masses and inertias that no body has; False takes them and makes a note.
    Attributes:
        notes: what was taken as it is.
    """

    def __init__(self, wanted: bool | Iterable[str], physical: bool = True) -> None:
        if not isinstance(wanted, bool) and (isinstance(wanted, str) or not isinstance(wanted, Iterable)):
            raise ModelError(f"load expects parameters=True or a list of names, got {wanted!r}")
        self.wanted = wanted if isinstance(wanted, bool) else set(wanted)
        self.known: list[str] = []
        self.physical = physical
        self.notes = list[str]()

    def of(self, owner: str, what: str, value: Any) -> Any:
        """The value, or a Parameter `<owner>_<what>` with it."""
        name = f"{owner}_{what}"
        self.known.append(name)
        chosen = self.wanted if isinstance(self.wanted, bool) else name in self.wanted
        return Parameter(name, value=np.asarray(value, dtype=np.float64)) if chosen else value

    def origin(self, owner: str, R: np.ndarray, p: np.ndarray) -> Any:
        """The pose of an origin, an expression where its position was asked for."""
        position = self.of(owner, "origin", p)
        return matrix(R, p) if position is p else Pose(R, position)

    def body(self, owner: str, mass: Any, center: Any, R: Any, tensor: Any, element: Element) -> SpatialInertia:
        """The body of a link, its tensor about its centre of mass in axes R. Raises ModelError if it is unphysical."""
        tensor = R @ tensor @ R.T
        tensor = 0.5 * (tensor + tensor.T)
        try:
            SpatialInertia(mass=mass, center_of_mass=center, inertia=tensor)
        except TwistaxError as error:
            if self.physical:
                raise element.wrong(
                    f"link {owner!r} has a mass or inertia that no body has. {error}\n"
                    "  or load it as it is, with physical=False"
                ) from None
            self.notes.append(f"link {owner!r} has a mass or inertia that no body has")
        return SpatialInertia(
            mass=self.of(owner, "mass", mass),
            center_of_mass=self.of(owner, "center_of_mass", center),
            inertia=self.of(owner, "inertia", tensor),
            physical=self.physical,
        )

    def check(self) -> None:
        """Raise ModelError for a name that the model does not have."""
        for name in sorted(set() if isinstance(self.wanted, bool) else self.wanted - set(self.known)):
            raise ModelError(f"load: the model calls no parameter {name!r}; expected: {listed(self.known, name)}")
