"""Example chains: the Panda arm, and a chain of equal links of any length."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..checks import whole
from ..errors import ModelError
from .bodies import SpatialInertia
from .joints import Revolute
from .mechanism import Chain
from .tree import Link

__all__ = ["equal_links", "modified_dh", "panda"]


def modified_dh(a: float, d: float, quarter_turns: int) -> NDArray[np.float64]:
    """The mount (4, 4) of a link with modified Denavit-Hartenberg parameters: Rot_x(alpha) Trans_x(a) Trans_z(d).

    The joint then rotates about z. alpha is quarter_turns times a quarter turn, so zeros are exact; a and d are in m.

    Raises: ModelError if quarter_turns is not a whole number.

    Source: J. Craig, Introduction to Robotics, chapter 3.
    """
    if not isinstance(quarter_turns, (int, np.integer)):
        raise ModelError(f"modified_dh expects quarter_turns as a whole number, got {quarter_turns!r}")
    cosine, sine = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[quarter_turns % 4]
    T = np.eye(4)
    T[1:3, 1:3] = [[cosine, -sine], [sine, cosine]]
    T[:3, 3] = [a, -d * sine, d * cosine]
    return T + 0.0  # no negative zeros


def panda() -> Chain:
    """The seven links of Franka's Panda, without a hand; the base's z axis points up.

    Friction and the rotors of the motors are omitted. Sources: the frames are from Franka's documentation, the inertias
    from C. Gaz and others, Dynamic Identification of the Franka Emika Panda Robot, IEEE Robotics and Automation Letters
    (2019). The file `panda.json` contains the numbers and the full titles.
    """
    links = []
    for i, link in enumerate(json.loads(Path(__file__).with_name("panda.json").read_text())["links"], start=1):
        xx, xy, xz, yy, yz, zz = link["inertia"]
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        body = SpatialInertia(mass=link["mass"], center_of_mass=link["center_of_mass"], inertia=inertia)
        mount = modified_dh(link["a"], link["d"], link["quarter_turns"])
        links.append(Link(Revolute(f"joint{i}", axis=(0.0, 0.0, 1.0)), body, mount))
    return Chain(links)


def equal_links(count: int) -> Chain:
    """A chain of equal rods, end to end, with hinges whose axes alternate by 90 degrees.

    At q = 0 it is straight along the base's x axis. Each rod has a mass of 1 kg, a length of 0.2 m, and a radius of
    0.02 m.

    Raises: ModelError if count is not a positive whole number.
    """
    whole("equal_links: count", count, 1, ModelError)
    mass, length, radius = 1.0, 0.2, 0.02
    across = mass * (3.0 * radius**2 + length**2) / 12.0
    body = SpatialInertia(
        mass=mass,
        center_of_mass=(0.5 * length, 0.0, 0.0),
        inertia=np.diag([0.5 * mass * radius**2, across, across]),
    )
    return Chain(
        Link(Revolute(f"joint{i}", axis=(0.0, 0.0, 1.0)), body, modified_dh(length if i else 0.0, 0.0, 1))
        for i in range(count)
    )
