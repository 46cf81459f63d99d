"""The dynamics of the cases as one writes them by hand in 6x6 matrices, lists and loops.

Written apart from the package's own dynamics, with the rates of the twists themselves. Source: R. Featherstone, Rigid
Body Dynamics Algorithms (2008), sections 5.3 (RNEA) and 7.3 (ABA), for twists [v; w] here.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .algebra import Algebra

__all__ = ["Links", "free_body", "inverse_dynamics", "forward_dynamics"]

#: Of each link: where its joint sits, T (4, 4), and its inertia (6, 6). All joints turn about z.
Links = Sequence[tuple[NDArray[np.float64], NDArray[np.float64]]]

_AXIS = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


def free_body(
    algebra: Algebra, M: NDArray[np.float64], mass_moment: tuple[float, NDArray[np.float64]], y: Any, V: Any, F: Any
) -> list[Any]:
    """The rates of position and quaternion (7,) and of the twist (6,), with weight.

    Args:
        M: the inertia (6, 6).
        mass_moment: the mass m, and m c with the centre of mass c.
        y, V, F: position and quaternion of any length (7,), twist (6,), wrench (6,).
    """
    mass, moment = mass_moment
    w, x, z = y[3], (y[4], y[5], y[6]), V[3:6]
    d = 2 / (w * w + x[0] * x[0] + x[1] * x[1] + x[2] * x[2])
    R = algebra.matrix(
        [
            [1 - d * (x[1] * x[1] + x[2] * x[2]), d * (x[0] * x[1] - w * x[2]), d * (x[0] * x[2] + w * x[1])],
            [d * (x[0] * x[1] + w * x[2]), 1 - d * (x[0] * x[0] + x[2] * x[2]), d * (x[1] * x[2] - w * x[0])],
            [d * (x[0] * x[2] - w * x[1]), d * (x[1] * x[2] + w * x[0]), 1 - d * (x[0] * x[0] + x[1] * x[1])],
        ]
    )
    turned = [
        -0.5 * (x[0] * z[0] + x[1] * z[1] + x[2] * z[2]),
        0.5 * (w * z[0] + x[1] * z[2] - x[2] * z[1]),
        0.5 * (w * z[1] + x[2] * z[0] - x[0] * z[2]),
        0.5 * (w * z[2] + x[0] * z[1] - x[1] * z[0]),
    ]
    down = R.T @ algebra.constant([0.0, 0.0, -9.81])
    weight = algebra.joined([mass * down, algebra.hat(algebra.constant(moment)) @ down])
    inertia, inverse = algebra.constant(M), algebra.constant(np.linalg.inv(M))
    net = F + weight + _ad(algebra, V).T @ (inertia @ V)
    return [algebra.joined([R @ V[:3], algebra.vector(turned)]), inverse @ net]


def inverse_dynamics(algebra: Algebra, links: Links, q: Any, qd: Any, qdd: Any) -> Any:
    """The forces of the motors (n,): RNEA."""
    S = algebra.constant(_AXIS)
    V, A = algebra.constant(np.zeros(6)), algebra.constant([0.0, 0.0, 9.81, 0.0, 0.0, 0.0])
    X, f = [], []
    for i, (mount, M) in enumerate(links):
        inertia = algebra.constant(M)
        X.append(_to_link(algebra, mount, q[i]))
        V = X[i] @ V + S * qd[i]
        ad = _ad(algebra, V)
        A = X[i] @ A + S * qdd[i] + ad @ (S * qd[i])
        f.append(inertia @ A - ad.T @ (inertia @ V))
    tau = []
    for i in reversed(range(len(links))):
        tau.append(algebra.dot(S, f[i]))
        if i:
            f[i - 1] = f[i - 1] + X[i].T @ f[i]
    return algebra.vector(tau[::-1])


def forward_dynamics(algebra: Algebra, links: Links, q: Any, qd: Any, tau: Any) -> Any:
    """The accelerations of the joints (n,): ABA."""
    S = algebra.constant(_AXIS)
    V = algebra.constant(np.zeros(6))
    X, c, I, p = [], [], [], []
    for i, (mount, M) in enumerate(links):
        I.append(algebra.constant(M))
        X.append(_to_link(algebra, mount, q[i]))
        V = X[i] @ V + S * qd[i]
        ad = _ad(algebra, V)
        c.append(ad @ (S * qd[i]))
        p.append(-(ad.T @ (I[i] @ V)))
    U, d, u = {}, {}, {}
    for i in reversed(range(len(links))):
        U[i] = I[i] @ S
        d[i] = algebra.dot(S, U[i])
        u[i] = tau[i] - algebra.dot(S, p[i])
        if i:
            left = I[i] - algebra.outer(U[i], U[i]) / d[i]
            I[i - 1] = I[i - 1] + X[i].T @ left @ X[i]
            p[i - 1] = p[i - 1] + X[i].T @ (p[i] + left @ c[i] + U[i] * (u[i] / d[i]))
    A, qdd = algebra.constant([0.0, 0.0, 9.81, 0.0, 0.0, 0.0]), []
    for i in range(len(links)):
        A = X[i] @ A + c[i]
        qdd.append((u[i] - algebra.dot(U[i], A)) / d[i])
        A = A + S * qdd[i]
    return algebra.vector(qdd)


def _to_link(algebra: Algebra, mount: NDArray[np.float64], q: Any) -> Any:
    """X (6, 6): twists in the frame of a link, of twists in that of the link before."""
    s, c = algebra.sin(q), algebra.cos(q)
    turn = algebra.matrix([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    back = (algebra.constant(mount[:3, :3]) @ turn).T
    zero = algebra.constant(np.zeros((3, 3)))
    return algebra.block([[back, -(back @ algebra.hat(algebra.constant(mount[:3, 3])))], [zero, back]])


def _ad(algebra: Algebra, V: Any) -> Any:
    """ad_V (6, 6)."""
    v, w = algebra.hat(V[:3]), algebra.hat(V[3:6])
    return algebra.block([[w, v], [algebra.constant(np.zeros((3, 3))), w]])
