"""The dynamics of the cases as one writes them by hand in 6x6 matrices, lists and loops.

Written apart from the package's own dynamics, with the rates of the twists themselves. Source: R. Featherstone, Rigid
Body Dynamics Algorithms (2008), sections 5.3 (RNEA) and 7.3 (ABA), for twists [v; w] here.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Links", "Matrices", "forward_dynamics", "free_body", "inverse_dynamics"]

#: Of each link: where its joint sits, T (4, 4), and its inertia (6, 6). All joints turn about z.
Links = Sequence[tuple[NDArray[np.float64], NDArray[np.float64]]]

_AXIS = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


class Matrices:
    """What operators do not say of vectors, matrices and scalars: in NumPy or jax.numpy, in their ordinary style.

    Another package that calculates with `+`, `-`, `*`, `@`, `.T` and slices overrides it.

    Args:
        xp: the module.
    """

    def __init__(self, xp: Any) -> None:
        self.xp = xp

    def constant(self, value: Any) -> Any:
        """Numbers."""
        return self.xp.asarray(np.asarray(value, float))

    def sin(self, x: Any) -> Any:
        return self.xp.sin(x)

    def cos(self, x: Any) -> Any:
        return self.xp.cos(x)

    def matrix(self, rows: Sequence[Sequence[Any]]) -> Any:
        """Of scalars."""
        return self.xp.array([list(row) for row in rows])

    def block(self, rows: Sequence[Sequence[Any]]) -> Any:
        """Of matrices."""
        return self.xp.block([list(row) for row in rows])

    def vector(self, entries: Sequence[Any]) -> Any:
        """Of scalars."""
        return self.xp.stack(list(entries))

    def joined(self, parts: Sequence[Any]) -> Any:
        """Of vectors."""
        return self.xp.concatenate(list(parts))

    def dot(self, a: Any, b: Any) -> Any:
        return a @ b

    def outer(self, a: Any, b: Any) -> Any:
        return self.xp.outer(a, b)

    def hat(self, w: Any) -> Any:
        """[w]x (3, 3)."""
        return self.matrix([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


def free_body(
    m: Matrices, M: NDArray[np.float64], mass_moment: tuple[float, NDArray[np.float64]], y: Any, V: Any, F: Any
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
    R = m.matrix(
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
    down = R.T @ m.constant([0.0, 0.0, -9.81])
    weight = m.joined([mass * down, m.hat(m.constant(moment)) @ down])
    inertia, inverse = m.constant(M), m.constant(np.linalg.inv(M))
    net = F + weight + _ad(m, V).T @ (inertia @ V)
    return [m.joined([R @ V[:3], m.vector(turned)]), inverse @ net]


def inverse_dynamics(m: Matrices, links: Links, q: Any, qd: Any, qdd: Any) -> Any:
    """The forces of the motors (n,): RNEA."""
    S = m.constant(_AXIS)
    V, A = m.constant(np.zeros(6)), m.constant([0.0, 0.0, 9.81, 0.0, 0.0, 0.0])
    X, f = [], []
    for i, (mount, M) in enumerate(links):
        inertia = m.constant(M)
        X.append(_to_link(m, mount, q[i]))
        V = X[i] @ V + S * qd[i]
        ad = _ad(m, V)
        A = X[i] @ A + S * qdd[i] + ad @ (S * qd[i])
        f.append(inertia @ A - ad.T @ (inertia @ V))
    tau = []
    for i in reversed(range(len(links))):
        tau.append(m.dot(S, f[i]))
        if i:
            f[i - 1] = f[i - 1] + X[i].T @ f[i]
    return m.vector(tau[::-1])


def forward_dynamics(m: Matrices, links: Links, q: Any, qd: Any, tau: Any) -> Any:
    """The accelerations of the joints (n,): ABA."""
    S = m.constant(_AXIS)
    V = m.constant(np.zeros(6))
    X, c, I, p = [], [], [], []
    for i, (mount, M) in enumerate(links):
        I.append(m.constant(M))
        X.append(_to_link(m, mount, q[i]))
        V = X[i] @ V + S * qd[i]
        ad = _ad(m, V)
        c.append(ad @ (S * qd[i]))
        p.append(-(ad.T @ (I[i] @ V)))
    U, d, u = {}, {}, {}
    for i in reversed(range(len(links))):
        U[i] = I[i] @ S
        d[i] = m.dot(S, U[i])
        u[i] = tau[i] - m.dot(S, p[i])
        if i:
            left = I[i] - m.outer(U[i], U[i]) / d[i]
            I[i - 1] = I[i - 1] + X[i].T @ left @ X[i]
            p[i - 1] = p[i - 1] + X[i].T @ (p[i] + left @ c[i] + U[i] * (u[i] / d[i]))
    A, qdd = m.constant([0.0, 0.0, 9.81, 0.0, 0.0, 0.0]), []
    for i in range(len(links)):
        A = X[i] @ A + c[i]
        qdd.append((u[i] - m.dot(U[i], A)) / d[i])
        A = A + S * qdd[i]
    return m.vector(qdd)


def _to_link(m: Matrices, mount: NDArray[np.float64], q: Any) -> Any:
    """X (6, 6): twists in the frame of a link, of twists in that of the link before."""
    s, c = m.sin(q), m.cos(q)
    turn = m.matrix([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    back = (m.constant(mount[:3, :3]) @ turn).T
    zero = m.constant(np.zeros((3, 3)))
    return m.block([[back, -(back @ m.hat(m.constant(mount[:3, 3])))], [zero, back]])


def _ad(m: Matrices, V: Any) -> Any:
    """ad_V (6, 6)."""
    v, w = m.hat(V[:3]), m.hat(V[3:6])
    return m.block([[w, v], [m.constant(np.zeros((3, 3))), w]])
