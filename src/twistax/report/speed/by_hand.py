"""The dynamics of the cases as one writes them by hand in 6x6 matrices, lists and loops.

Written apart from the package's own dynamics, with the rates of the twists themselves. Source: R. Featherstone, Rigid
Body Dynamics Algorithms (2008), sections 5.3 (RNEA) and 7.3 (ABA), for twists [v; w] here.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
#: Of each link: where its joint sits, T (4, 4), and its inertia (6, 6). All joints turn about z.
Links = Sequence[tuple[Array, Array]]

_AXIS = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


def free_body(xp: Any, M: Array, mass: float, moment: Array, y: Any, V: Any, F: Any) -> list[Any]:
    """The rates of position and quaternion y (7,), of any length, and of the twist V (6,), with weight and a wrench F.

    M is the inertia (6, 6), the moment the mass times the centre of mass.
    """
    w, x, z = y[3], (y[4], y[5], y[6]), V[3:6]
    d = 2 / (w * w + x[0] * x[0] + x[1] * x[1] + x[2] * x[2])
    R = xp.array(
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
    down = R.T @ xp.asarray([0.0, 0.0, -9.81])
    weight = xp.concatenate([mass * down, _hat(xp, xp.asarray(moment)) @ down])
    inertia, inverse = xp.asarray(M), xp.asarray(np.linalg.inv(M))
    net = F + weight + _ad(xp, V).T @ (inertia @ V)
    return [xp.concatenate([R @ V[:3], xp.stack(turned)]), inverse @ net]


def inverse_dynamics(xp: Any, links: Links, q: Any, qd: Any, qdd: Any) -> Any:
    """The forces of the motors (n,): RNEA."""
    S = xp.asarray(_AXIS)
    V, A = xp.asarray(np.zeros(6)), xp.asarray([0.0, 0.0, 9.81, 0.0, 0.0, 0.0])
    X, f = [], []
    for i, (mount, M) in enumerate(links):
        inertia = xp.asarray(M)
        X.append(_to_link(xp, mount, q[i]))
        V = X[i] @ V + S * qd[i]
        ad = _ad(xp, V)
        A = X[i] @ A + S * qdd[i] + ad @ (S * qd[i])
        f.append(inertia @ A - ad.T @ (inertia @ V))
    tau = []
    for i in reversed(range(len(links))):
        tau.append(xp.dot(S, f[i]))
        if i:
            f[i - 1] = f[i - 1] + X[i].T @ f[i]
    return xp.stack(tau[::-1])


def forward_dynamics(xp: Any, links: Links, q: Any, qd: Any, tau: Any) -> Any:
    """The accelerations of the joints (n,): ABA."""
    S = xp.asarray(_AXIS)
    V = xp.asarray(np.zeros(6))
    X, c, I, p = [], [], [], []
    for i, (mount, M) in enumerate(links):
        I.append(xp.asarray(M))
        X.append(_to_link(xp, mount, q[i]))
        V = X[i] @ V + S * qd[i]
        ad = _ad(xp, V)
        c.append(ad @ (S * qd[i]))
        p.append(-(ad.T @ (I[i] @ V)))
    U, d, u = {}, {}, {}
    for i in reversed(range(len(links))):
        U[i] = I[i] @ S
        d[i] = xp.dot(S, U[i])
        u[i] = tau[i] - xp.dot(S, p[i])
        if i:
            left = I[i] - xp.outer(U[i], U[i]) / d[i]
            I[i - 1] = I[i - 1] + X[i].T @ left @ X[i]
            p[i - 1] = p[i - 1] + X[i].T @ (p[i] + left @ c[i] + U[i] * (u[i] / d[i]))
    A, qdd = xp.asarray([0.0, 0.0, 9.81, 0.0, 0.0, 0.0]), []
    for i in range(len(links)):
        A = X[i] @ A + c[i]
        qdd.append((u[i] - xp.dot(U[i], A)) / d[i])
        A = A + S * qdd[i]
    return xp.stack(qdd)


def _to_link(xp: Any, mount: Array, q: Any) -> Any:
    """X (6, 6): twists in the frame of a link, of twists in that of the link before."""
    s, c = xp.sin(q), xp.cos(q)
    turn = xp.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    back = (xp.asarray(mount[:3, :3]) @ turn).T
    zero = xp.asarray(np.zeros((3, 3)))
    return xp.block([[back, -(back @ _hat(xp, xp.asarray(mount[:3, 3])))], [zero, back]])


def _ad(xp: Any, V: Any) -> Any:
    """ad_V (6, 6)."""
    v, w = _hat(xp, V[:3]), _hat(xp, V[3:6])
    return xp.block([[w, v], [xp.asarray(np.zeros((3, 3))), w]])


def _hat(xp: Any, w: Any) -> Any:
    """[w]x (3, 3)."""
    return xp.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
