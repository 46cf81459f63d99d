"""The functions that are evaluated: a free body and chains, as systems of the package and in plain matrices."""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

import twistax as tx

from ...mechanics import Chain, SpatialInertia, chain_models, forward_dynamics, inverse_dynamics
from ...mechanics.flight import numbers

Array = NDArray[np.float64]
#: For each link the pose of its joint, T (4, 4), and its inertia (6, 6). All joints turn about z.
Links = Sequence[tuple[Array, Array]]
#: x, u and params of a call of the dynamics.
Inputs = tuple[dict[str, Any], dict[str, Any], dict[str, Any]]


@dataclasses.dataclass(frozen=True, eq=False)
class EvaluatedFunction:
    """A function of three vectors to one, as a system of the package and by hand. Derivatives are by the first two."""

    name: str  # on the command line
    title: str  # on the page
    sizes: tuple[int, int, int]  # of the arguments
    results: int  # length of the result
    rates: tuple[str, ...]  # the states whose rates, one after the other, are the result
    by: tuple[str, ...]  # what `dynamics.jacobian` takes derivatives by, in the order of the arguments
    system: Callable[[], tx.System]  # with our own nodes; made anew on each call
    inputs: Callable[[Any, Any, Any], Inputs]  # the three vectors as x, u and params of the system
    #: The result in plain matrices of NumPy, or what is called alike, in as many vectors as `rates` has names.
    by_hand: Callable[[Any, Any, Any, Any], list[Any]]
    chain: Callable[[], Chain] | None = None  # and whether it gives forces, or accelerations
    inverse: bool = False

    def points(self, count: int) -> tuple[Array, Array, Array]:
        """Random arguments, (count, size) each; the first ones are the same for every count."""
        drawn = np.random.default_rng(20240611).normal(size=(count, sum(self.sizes)))
        a, b, c = np.split(drawn, np.cumsum(self.sizes)[:-1], axis=1)
        if self.chain is None:
            a[:, 3:] /= np.linalg.norm(a[:, 3:], axis=1, keepdims=True)
        return a, b, c

    def run_by(self, dynamics: tx.Dynamics) -> Callable[..., list[Any]]:
        """The function, evaluated by a compiled system."""
        return lambda *points: list(map(dynamics(0.0, *self.inputs(*points)).__getitem__, self.rates))


# ---- by hand, in 6x6 matrices, lists and loops ----------------------------------------------------------------------
#
# Written apart from the package's own dynamics, with the rates of the twists themselves. Source: R. Featherstone, Rigid
# Body Dynamics Algorithms (2008), sections 5.3 (RNEA) and 7.3 (ABA), for twists [v; w] here.

_AXIS = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


def body_by_hand(xp: Any, M: Array, mass: float, moment: Array, y: Any, V: Any, F: Any) -> list[Any]:
    """The rates of position and quaternion y (7,), of any length, and of the twist V (6,), with weight and a wrench F.

    M is the inertia (6, 6), the moment the mass times the centre of mass.
    """
    w, x, z, X = y[3], y[4:7], V[3:6], _hat(xp, y[4:7])
    R = xp.asarray(np.eye(3)) + 2 / (w * w + xp.dot(x, x)) * (w * X + X @ X)
    turned = [-0.5 * xp.stack([xp.dot(x, z)]), 0.5 * (w * z + X @ z)]
    down = R.T @ xp.asarray([0.0, 0.0, -9.81])
    weight = xp.concatenate([mass * down, _hat(xp, xp.asarray(moment)) @ down])
    inertia, inverse = xp.asarray(M), xp.asarray(np.linalg.inv(M))
    net = F + weight + _ad(xp, V).T @ (inertia @ V)
    return [xp.concatenate([R @ V[:3], *turned]), inverse @ net]


def rnea_by_hand(xp: Any, links: Links, q: Any, qd: Any, qdd: Any) -> Any:
    """The motor forces (n,) by the recursive Newton-Euler algorithm."""
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
    for i in reversed(range(1, len(links))):
        f[i - 1] = f[i - 1] + X[i].T @ f[i]
    return xp.stack([xp.dot(S, force) for force in f])


def aba_by_hand(xp: Any, links: Links, q: Any, qd: Any, tau: Any) -> Any:
    """The joint accelerations (n,) by the articulated-body algorithm."""
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
    v, w = _hat(xp, V[:3]), _hat(xp, V[3:6])
    return xp.block([[w, v], [xp.asarray(np.zeros((3, 3))), w]])


def _hat(xp: Any, w: Any) -> Any:
    return xp.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


#: Mass, kg, centre of mass, m, and inertia about it, kg m2, of the free body.
MASS, CENTER = 2.3, np.array([0.05, -0.02, 0.08])
_TENSOR = np.array([[0.05, 0.004, 0.002], [0.004, 0.04, 0.003], [0.002, 0.003, 0.03]])
_BODY = SpatialInertia(mass=MASS, center_of_mass=CENTER, inertia=_TENSOR)


@functools.cache
def inertia() -> Array:
    """The spatial inertia (6, 6) of the free body."""
    return numbers(_BODY.matrix)


def _free_body() -> tx.System:
    """Rates of position and quaternion (7,) and of the twist (6,), under weight and a wrench."""
    y, V, F = tx.State("y", shape=(7,)), tx.State("V", shape=(6,)), tx.Control("F", shape=(6,))
    v, w, q = V[:3], V[3:], y[3:]
    R = tx.spatial.QDCM(q)
    pose = tx.Block([[R, np.zeros((3, 1))], [np.zeros((1, 3)), np.ones((1, 1))]])
    wrench = F + _BODY.weight(pose, np.array([0.0, 0.0, -9.81]))
    moved = tx.Concat(R @ v, 0.5 * tx.spatial.SSMP(w) @ q)
    return tx.System(rates={y: moved, V: _BODY.acceleration(V, wrench)})


FREE_BODY = EvaluatedFunction(
    "free-body",
    "free body, 13 states",
    *((7, 6, 6), 13, ("y", "V"), ("x",)),
    _free_body,
    lambda a, b, c: ({"y": a, "V": b}, {"F": c}, {}),
    lambda xp, a, b, c: body_by_hand(xp, inertia(), MASS, MASS * CENTER, a, b, c),
)


def _numbers_of(chain: Chain) -> list[tuple[Any, Any]]:
    return [
        (numbers(link.mount), numbers(body.matrix))
        for link, body in zip(chain.links, chain.bodies.values(), strict=True)
    ]


def _of_chain(name: str, n: int, model: Callable[[], Chain], inverse: bool) -> EvaluatedFunction:
    """Inverse dynamics of a chain, or its forward dynamics."""
    chain = functools.cache(model)  # made when first asked for: the command line only needs names
    links = functools.cache(lambda: _numbers_of(chain()))
    ours: Any = inverse_dynamics if inverse else forward_dynamics
    plain: Any = rnea_by_hand if inverse else aba_by_hand

    def system() -> tx.System:
        q, qd = tx.Control("q", shape=(n,)), tx.State("qd", shape=(n,))
        third = tx.Parameter("third", shape=(n,), value=np.zeros(n))
        return tx.System(rates={qd: ours(chain(), q, qd, third)}, parameters=[third])

    return EvaluatedFunction(
        f"{name.lower()}-{n}",
        f"{name}, {n} links",
        *((n, n, n), n, ("qd",), ("u", "x")),
        system,
        lambda a, b, c: ({"qd": b}, {"q": a}, {"third": c}),
        lambda xp, a, b, c: [plain(xp, links(), a, b, c)],
        *(chain, inverse),
    )


_MODELS: dict[int, Callable[[], Chain]] = {7: chain_models.panda, 30: functools.partial(chain_models.equal_links, 30)}
_CHAINS = [_of_chain(k, n, model, k == "RNEA") for n, model in _MODELS.items() for k in ("RNEA", "ABA")]

#: By name.
CASES: dict[str, EvaluatedFunction] = {case.name: case for case in (FREE_BODY, *_CHAINS)}
