"""What is evaluated: a free body and chains, as systems of the package and in plain matrices."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray

import twistax as tx

from ...mechanics import Chain, SpatialInertia, chain_models, forward_dynamics, inverse_dynamics
from . import by_hand
from .by_hand import Links

Array = NDArray[np.float64]
#: x, u and params of a call of the dynamics.
Inputs = tuple[dict[str, Any], dict[str, Any], dict[str, Any]]


class _Function:
    """A function of three vectors to one. Derivatives are by the first two.

    Attributes:
        name: on the command line.
        title: on the page.
        sizes: of the arguments.
        results: length of the result.
        rates: the states whose rates, one after the other, are the result.
        by: what `dynamics.jacobian` takes derivatives by, in the order of the arguments.
    """

    name: str
    title: str
    sizes: tuple[int, int, int]
    results: int
    rates: tuple[str, ...]
    by: tuple[str, ...]

    @property
    def columns(self) -> int:
        """Of the Jacobian."""
        return self.sizes[0] + self.sizes[1]

    def points(self, count: int) -> tuple[Array, Array, Array]:
        """Random arguments, (count, size) each; the first ones are the same for every count."""
        drawn = np.random.default_rng(20240611).normal(size=(count, sum(self.sizes)))
        a, b, c = np.split(drawn, np.cumsum(self.sizes)[:-1], axis=1)
        return a, b, c

    def read(self, rates: Mapping[str, Any]) -> list[Any]:
        """The result from the rates of the system."""
        return [rates[name] for name in self.rates]


class FreeBody(_Function):
    """Rates of position and quaternion (7,) and of the twist (6,), under weight and a wrench."""

    name, title = "free-body", "free body, 13 states"
    sizes, results = (7, 6, 6), 13
    rates, by = ("y", "V"), ("x",)

    @functools.cached_property
    def body(self) -> SpatialInertia:
        tensor = np.array([[0.05, 0.004, 0.002], [0.004, 0.04, 0.003], [0.002, 0.003, 0.03]])
        return SpatialInertia(mass=2.3, center_of_mass=(0.05, -0.02, 0.08), inertia=tensor)

    @functools.cached_property
    def mass_moment(self) -> tuple[float, Array]:
        """m, and m c (3,)."""
        mass, center = (np.asarray(numbers(each)) for each in (self.body.mass, self.body.center_of_mass))
        return float(mass), mass * center

    @functools.cached_property
    def inertia(self) -> Array:
        """M (6, 6)."""
        return numbers(self.body.matrix)

    def points(self, count: int) -> tuple[Array, Array, Array]:
        a, b, c = super().points(count)
        a[:, 3:] /= np.linalg.norm(a[:, 3:], axis=1, keepdims=True)
        return a, b, c

    def system(self) -> tx.System:
        """With our own nodes; made anew on each call."""
        y, V, F = tx.State("y", shape=(7,)), tx.State("V", shape=(6,)), tx.Control("F", shape=(6,))
        v, w, q = V[:3], V[3:], y[3:]
        R = tx.spatial.QDCM(q)
        pose = tx.Block([[R, np.zeros((3, 1))], [np.zeros((1, 3)), np.ones((1, 1))]])
        wrench = F + self.body.weight(pose, np.array([0.0, 0.0, -9.81]))
        moved = tx.Concat(R @ v, 0.5 * tx.spatial.SSMP(w) @ q)
        return tx.System(rates={y: moved, V: self.body.acceleration(V, wrench)})

    def inputs(self, a: Any, b: Any, c: Any) -> Inputs:
        """The three vectors as x, u and params of the system."""
        return {"y": a, "V": b}, {"F": c}, {}

    def by_hand(self, xp: Any, a: Any, b: Any, c: Any) -> list[Any]:
        """The result in plain matrices of NumPy, or what is called alike, in as many vectors as `rates` has names."""
        return by_hand.free_body(xp, self.inertia, self.mass_moment, a, b, c)


class OfChain(_Function):
    """Of positions, velocities and accelerations of a chain the forces of its motors, or the other way round."""

    rates, by = ("qd",), ("u", "x")

    def __init__(self, name: str, title: str, links: int, model: Callable[[], Chain], inverse: bool) -> None:
        self.name, self.title, self._model, self.inverse = name, title, model, inverse
        self.sizes, self.results = (links, links, links), links

    @functools.cached_property
    def chain(self) -> Chain:
        """Made when first asked for: the command line only needs names."""
        return self._model()

    @functools.cached_property
    def links(self) -> Links:
        return [(numbers(link.mount), numbers(link.body.matrix)) for link in self.chain.links]

    def system(self) -> tx.System:
        n, algorithm = self.results, inverse_dynamics if self.inverse else forward_dynamics
        q, qd = tx.Control("q", shape=(n,)), tx.State("qd", shape=(n,))
        third = tx.Parameter("third", shape=(n,), value=np.zeros(n))
        return tx.System(rates={qd: algorithm(self.chain, q, qd, third)}, parameters=[third])

    def inputs(self, a: Any, b: Any, c: Any) -> Inputs:
        return {"qd": b}, {"q": a}, {"third": c}

    def by_hand(self, xp: Any, a: Any, b: Any, c: Any) -> list[Any]:
        algorithm = by_hand.inverse_dynamics if self.inverse else by_hand.forward_dynamics
        return [algorithm(xp, self.links, a, b, c)]


#: What is evaluated.
Case = FreeBody | OfChain


def numbers(value: Any) -> Array:
    """A constant expression as an array, also while something is traced."""
    with jax.ensure_compile_time_eval():
        return np.asarray(tx.lower(value)(0.0, {}), np.float64)


def _cases() -> list[Case]:
    arm, rods = chain_models.panda, functools.partial(chain_models.equal_links, 30)
    return [
        FreeBody(),
        OfChain("rnea-7", "RNEA, 7 links", 7, arm, inverse=True),
        OfChain("aba-7", "ABA, 7 links", 7, arm, inverse=False),
        OfChain("rnea-30", "RNEA, 30 links", 30, rods, inverse=True),
        OfChain("aba-30", "ABA, 30 links", 30, rods, inverse=False),
    ]


#: By name.
CASES: dict[str, Case] = {case.name: case for case in _cases()}
