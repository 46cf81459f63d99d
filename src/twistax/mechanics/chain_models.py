"""Chains with numbers: the arm of a Panda, and a chain of equal links of any length."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..errors import ModelError
from .bodies import SpatialInertia
from .chain import Chain, Link
from .joints import Revolute

__all__ = ["equal_links", "modified_dh", "panda"]

#: a (m), d (m) and alpha in quarter turns of each link.
_PANDA_FRAMES = (
    (0.0, 0.333, 0),
    (0.0, 0.0, -1),
    (0.0, 0.316, 1),
    (0.0825, 0.0, 1),
    (-0.0825, 0.384, -1),
    (0.0, 0.0, 1),
    (0.088, 0.0, 1),
)

#: Mass (kg), centre of mass (m) and xx, xy, xz, yy, yz, zz of the inertia about it (kg m2), in the link's frame.
_PANDA_BODIES = (
    (4.970684, (0.003875, 0.002081, -0.04762), (0.70337, -0.000139, 0.006772, 0.70661, 0.019169, 0.009117)),
    (0.646926, (-0.003141, -0.02872, 0.003495), (0.007962, -0.003925, 0.010254, 0.02811, 0.000704, 0.025995)),
    (3.228604, (0.027518, 0.039252, -0.066502), (0.037242, -0.004761, -0.011396, 0.036155, -0.012805, 0.01083)),
    (3.587895, (-0.05317, 0.104419, 0.027454), (0.025853, 0.007796, -0.001332, 0.019552, 0.008641, 0.028323)),
    (1.225946, (-0.011953, 0.041065, -0.038437), (0.035549, -0.002117, -0.004037, 0.029474, 0.000229, 0.008627)),
    (1.666555, (0.060149, -0.014117, -0.010517), (0.001964, 0.000109, -0.001158, 0.004354, 0.000341, 0.005433)),
    (0.735522, (0.010517, -0.004252, 0.061597), (0.012516, -0.000428, -0.001196, 0.010027, -0.000741, 0.004815)),
)


def modified_dh(a: float, d: float, quarter_turns: int) -> NDArray[np.float64]:
    """The mount (4, 4) of a link with modified Denavit-Hartenberg parameters: Rot_x(alpha) Trans_x(a) Trans_z(d).

    The joint then turns about z. alpha is a whole number of quarter turns, so that the zeros are zeros.

    Source: J. Craig, Introduction to Robotics, chapter 3.
    """
    cosine, sine = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[quarter_turns % 4]
    T = np.eye(4)
    T[1:3, 1:3] = [[cosine, -sine], [sine, cosine]]
    T[:3, 3] = [a, -d * sine, d * cosine]
    return T + 0.0  # no negative zeros


def panda() -> Chain:
    """The seven links of Franka's Panda, without a hand; the base's z axis points up.

    Source: the modified Denavit-Hartenberg parameters are those of Franka's documentation. The inertias are those
    identified by C. Gaz, M. Cognetti, A. Oliva, P. Robuffo Giordano, A. De Luca, Dynamic Identification of the Franka
    Emika Panda Robot With Retrieval of Feasible Parameters Using Penalty-Based Optimization, IEEE Robotics and
    Automation Letters (2019), as Franka's package franka_ros lists them about the centres of mass. Friction and the
    rotors of the motors are left out.
    """
    links = []
    for i, (frame, (mass, center, tensor)) in enumerate(zip(_PANDA_FRAMES, _PANDA_BODIES, strict=True), start=1):
        xx, xy, xz, yy, yz, zz = tensor
        body = SpatialInertia(
            mass=mass, center_of_mass=center, inertia=np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        )
        links.append(Link(Revolute(f"joint{i}", axis=(0.0, 0.0, 1.0)), body, modified_dh(*frame)))
    return Chain(links)


def equal_links(count: int) -> Chain:
    """A chain of equal rods, end to end, on hinges that are turned against each other by a quarter turn.

    At q = 0 it is stretched along the base's x axis. Each rod has 1 kg, 0.2 m, and a radius of 0.02 m.

    Raises: ModelError if count is no positive whole number.
    """
    if not isinstance(count, int) or count < 1:
        raise ModelError(f"equal_links expects a positive whole number of links, got {count!r}")
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
