"""What the caller of `load` decides: which numbers become Parameters, and whose mass or inertia is not checked."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Iterable, Mapping
from typing import Any

import numpy as np

from ...checks import listed, short
from ...errors import ModelError, TwistaxError
from ...expr import Parameter
from ...expr.lie import Pose
from ..arguments import matrix
from ..bodies import SpatialInertia
from ..tree import Link, segments_of, sorted_links
from .xml_file import Element


@dataclasses.dataclass(frozen=True)
class _Doubt:
    """A link whose mass and inertia no body has: why, whether its mass is negative, and where it stands."""

    why: str
    negative: bool
    element: Element


class Choices:
    """Makes Parameters of the numbers that were asked for and leaves the others. Checks masses and inertias.

    Args:
        wanted: True for all, or names.
        physical: False for all links, or {name of a link: False}, whose masses and inertias are taken as they are.
    Attributes:
        length: the largest distance in the file between two of its frames, m. What an inertia has below the round-off
            of mass times length^2 has no effect.
        doubts: by link what is wrong with its mass or inertia. `judge` decides.
        notes: what was taken as it is, or changed.
    """

    def __init__(self, wanted: bool | Iterable[str], physical: bool | Mapping[str, bool] = True) -> None:
        if not isinstance(wanted, bool) and (isinstance(wanted, str) or not isinstance(wanted, Iterable)):
            raise ModelError(f"load expects parameters=True or a list of names, got {wanted!r}")
        by_link = isinstance(physical, Mapping) and all(isinstance(value, bool) for value in physical.values())
        if not by_link and not isinstance(physical, bool):
            raise ModelError(
                f"load expects physical=True, False, or a mapping of links such as {{'tool': False}}, got "
                f"{short(physical)}"
            )
        self.wanted = wanted if isinstance(wanted, bool) else set(wanted)
        self.known: list[str] = []
        self.physical = physical
        self.length = 0.0
        self.doubts = dict[str, _Doubt]()
        self.notes = list[str]()
        self._bodies, self._rounded = list[str](), list[str]()

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

    def body(self, owner: str, mass: float, center: Any, R: Any, tensor: Any, element: Element) -> SpatialInertia:
        """The body of a link, its tensor about its centre of mass in axes R."""
        tensor = R @ tensor @ R.T
        tensor = 0.5 * (tensor + tensor.T)
        why = _objection(mass, center, tensor)
        if why is not None:
            floor = np.finfo(np.float64).eps * mass * self.length**2
            without = np.where(np.abs(tensor) <= floor, 0.0, tensor)
            if _objection(mass, center, without) is None:
                tensor, why = without, None
                self._rounded.append(owner)
        if why is not None:
            self.doubts[owner] = _Doubt(why, mass < 0.0, element)
        self._bodies.append(owner)
        return SpatialInertia(
            mass=self.of(owner, "mass", mass) if mass else mass,  # two that may be zero have no centre together
            center_of_mass=self.of(owner, "center_of_mass", center),
            inertia=self.of(owner, "inertia", tensor),
            physical=why is None,
        )

    def judge(self, links: Collection[Link], base: str) -> None:
        """Decide about the doubts, by what is fixed together and so moves as one body.

        A link that does not move, or whose mass is not negative and that is part of a body that is physical, gets a
        note. So does one whose mass and inertia are to be taken as they are.

        Args:
            links: of the model, with numbers for masses and inertias.
            base: the name of the base.
        Raises: ModelError for the others.
        """
        segments, frames = segments_of(sorted_links(links, base), (), base) if links else ((), {})
        refused = list[str]()
        for owner, doubt in self.doubts.items():
            at = frames[owner].segment if owner in frames else -1
            body = segments[at].body if at >= 0 else None
            what = f"link {owner!r} has a mass or inertia that no body has"
            if at < 0:
                self.notes.append(f"{what}; it does not move")
            elif body is not None and not doubt.negative and _objection_to(body) is None:
                self.notes.append(f"{what}; the links fixed to it make it one that is possible")
            elif not (self.physical if isinstance(self.physical, bool) else self.physical.get(owner, True)):
                self.notes.append(f"{what}, taken as it is")
            else:
                refused.append(owner)
        if refused:
            doubt, others = self.doubts[refused[0]], ", ".join(map(repr, refused[1:]))
            raise doubt.element.wrong(
                f"link {refused[0]!r} has a mass or inertia that no body has. {doubt.why}\n"
                + (f"  so have {others}\n" if others else "")
                + f"  or take them as they are by physical={dict.fromkeys(refused, False)}"
            )

    def finish(self) -> None:
        """Note what was rounded. Raises ModelError for a name that the model does not have."""
        if self._rounded:
            self.notes.append(f"inertias that are round-off, here zero: of {listed(self._rounded)}")
        for name in sorted(set() if isinstance(self.wanted, bool) else self.wanted - set(self.known)):
            raise ModelError(f"load: the model calls no parameter {name!r}; expected: {listed(self.known, name)}")
        for name in () if isinstance(self.physical, bool) else self.physical:
            if name not in self._bodies:
                raise ModelError(f"load: physical names {name!r}; links with a mass are: {listed(self._bodies, name)}")


def _objection(mass: Any, center: Any, tensor: Any) -> str | None:
    """Why no body has these; None if one may have them."""
    try:
        SpatialInertia(mass=mass, center_of_mass=center, inertia=tensor)
    except TwistaxError as error:
        return str(error)
    return None


def _objection_to(body: SpatialInertia) -> str | None:
    return _objection(body.mass, body.center_of_mass, body.inertia)
