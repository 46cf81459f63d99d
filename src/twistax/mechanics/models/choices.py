"""Options of `load`: which numbers become Parameters, and which unphysical masses and inertias are accepted."""

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
from ..bodies import SpatialInertia, positive_definite
from ..tree import Link, segments_of, sorted_links
from .xml_file import Element


@dataclasses.dataclass(frozen=True)
class _UnphysicalLink:
    """A link with a mass or inertia that is not physical.

    Attributes:
        why: the error message of `SpatialInertia`.
        mass: mass of the link.
        moments: principal moments about its centre of mass, smallest first.
        signs: whether the inertia is physical with the opposite sign of the products of inertia.
        element: the link's element in the file.
    """

    why: str
    mass: float
    moments: np.ndarray
    signs: bool
    element: Element

    @property
    def numbers(self) -> str:
        return f"{self.mass:.4g} kg, principal moments {', '.join(f'{moment:.4g}' for moment in self.moments)} kg m2"

    @property
    def hint(self) -> str:
        """A possible cause of the error in the file."""
        return ", but has with the other sign of the products of inertia" if self.signs else ""


class Choices:
    """Makes Parameters of the numbers that `wanted` names, and checks masses and inertias.

    Args:
        wanted: True for all numbers, or names.
        physical: which unphysical masses and inertias are accepted. None: those with which the equations of motion have
            a unique solution. True: none. False: all. A mapping has True or False for single links; None for others.
    Attributes:
        length: the largest distance in the file between two of its frames, m. Entries of an inertia below the round-off
            of mass times length^2 have no effect.
        doubts: the unphysical links by name, which the method `judge` refuses or accepts.
        notes: what was accepted unchanged, or changed.
    """

    def __init__(self, wanted: bool | Iterable[str], physical: bool | Mapping[str, bool] | None = None) -> None:
        if not isinstance(wanted, bool) and (isinstance(wanted, str) or not isinstance(wanted, Iterable)):
            raise ModelError(f"load expects parameters=True or a list of names, got {wanted!r}")
        by_link = isinstance(physical, Mapping) and all(isinstance(value, bool) for value in physical.values())
        if not by_link and physical is not None and not isinstance(physical, bool):
            raise ModelError(
                f"load expects physical=True, False, or a mapping of links such as {{'tool': False}}, got "
                f"{short(physical)}"
            )
        self.wanted = wanted if isinstance(wanted, bool) else set(wanted)
        self.known: list[str] = []
        self.physical = physical
        self.length = 0.0
        self.doubts = dict[str, _UnphysicalLink]()
        self.notes = list[str]()
        self._bodies, self._rounded = list[str](), list[str]()

    def of(self, owner: str, what: str, value: Any) -> Any:
        """The value; if it is a requested Parameter, a Parameter `<owner>_<what>` with that value."""
        name = f"{owner}_{what}"
        self.known.append(name)
        chosen = self.wanted if isinstance(self.wanted, bool) else name in self.wanted
        return Parameter(name, value=np.asarray(value, dtype=np.float64)) if chosen else value

    def origin(self, owner: str, R: np.ndarray, p: np.ndarray) -> Any:
        """The pose of an <origin>; an expression if its position is a Parameter."""
        position = self.of(owner, "origin", p)
        return matrix(R, p) if position is p else Pose(R, position)

    def body(self, owner: str, mass: float, center: Any, R: Any, tensor: Any, element: Element) -> SpatialInertia:
        """The body of a link, from its inertia tensor about its centre of mass in axes R."""
        products = tensor - np.diag(np.diag(tensor))
        other_signs = tensor - 2.0 * products
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
            signs = bool(products.any()) and _objection(mass, center, other_signs) is None
            self.doubts[owner] = _UnphysicalLink(why, mass, np.linalg.eigvalsh(tensor), signs, element)
        self._bodies.append(owner)
        return SpatialInertia(
            mass=self.of(owner, "mass", mass)
            if mass
            else mass,  # two bodies whose masses may be zero have no centre of mass
            center_of_mass=self.of(owner, "center_of_mass", center),
            inertia=self.of(owner, "inertia", tensor),
            physical=why is None,
        )

    def judge(self, links: Collection[Link], base: str) -> None:
        """Refuse or note the unphysical links, depending on the bodies that they form with all that is fixed to them.

        A link gets a note if it does not move, if the whole body is physical, if the caller accepts the link unchanged,
        or if the whole body has a positive definite spatial inertia and the caller requires no more. If all moving
        bodies are positive definite, the mass matrix is too, so the equations of motion have a unique solution. A
        negative mass is accepted only if the caller accepts it explicitly.

        Args:
            links: the links of the model, with numbers for masses and inertias.
            base: the name of the base.
        Raises: ModelError for the links that are refused.
        """
        segments, frames = segments_of(sorted_links(links, base), (), base) if links else ((), {})
        refused = list[str]()
        for owner, doubt in self.doubts.items():
            at = frames[owner].segment if owner in frames else -1
            body = segments[at].body if at >= 0 else None
            demanded = self.physical.get(owner) if isinstance(self.physical, Mapping) else self.physical
            positive = body is not None and doubt.mass >= 0.0
            what = f"link {owner!r} has a mass or inertia that no body has"
            if at < 0:
                self.notes.append(f"{what}; it does not move")
            elif body is not None and positive and _objection_to(body) is None:
                self.notes.append(f"{what}; the links fixed to it make it one that is possible")
            elif demanded is False:
                self.notes.append(f"{what}, taken as it is")
            elif body is not None and positive and demanded is None and _well_posed(body):
                self.notes.append(
                    f"{what} ({doubt.numbers}){doubt.hint}; it is taken as it is, for the equations of motion have one "
                    f"solution. physical={{{owner!r}: True}} refuses it"
                )
            else:
                refused.append(owner)
        if refused:
            doubt, further = self.doubts[refused[0]], ", ".join(map(repr, refused[1:]))
            raise doubt.element.wrong(
                f"link {refused[0]!r} has a mass or inertia that no body has{doubt.hint}. {doubt.why}\n"
                + (f"  so have {further}\n" if further else "")
                + f"  or take them as they are by physical={dict.fromkeys(refused, False)}"
            )

    def finish(self) -> None:
        """Note what was rounded. Raises ModelError for a name that the model does not have."""
        if self._rounded:
            self.notes.append(f"inertias that are round-off, here zero: of {listed(self._rounded)}")
        for name in sorted(set() if isinstance(self.wanted, bool) else self.wanted - set(self.known)):
            raise ModelError(f"load: the model has no parameter {name!r}; there are: {listed(self.known, name)}")
        for name in self.physical if isinstance(self.physical, Mapping) else ():
            if name not in self._bodies:
                raise ModelError(f"load: physical names {name!r}; links with a mass are: {listed(self._bodies, name)}")


def _objection(mass: Any, center: Any, tensor: Any) -> str | None:
    """The reason why this mass and inertia are not physical; None if they are."""
    try:
        SpatialInertia(mass=mass, center_of_mass=center, inertia=tensor)
    except TwistaxError as error:
        return str(error)
    return None


def _objection_to(body: SpatialInertia) -> str | None:
    return _objection(body.mass, body.center_of_mass, body.inertia)


def _well_posed(body: SpatialInertia) -> bool:
    """Whether the spatial inertia of a numeric body is positive definite: then it has a unique acceleration for each
    wrench.
    """
    parts: tuple[Any, Any] = (body.mass, body.inertia)
    mass, tensor = (np.asarray(part.value) for part in parts)
    return bool(mass > 0.0) and positive_definite(tensor)
