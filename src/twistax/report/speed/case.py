"""What is evaluated: a free body and chains, as systems of the package and in plain matrices."""

from __future__ import annotations

import functools
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray

import twistax as tx

from ...mechanics import Chain, SpatialInertia, chain_models, forward_dynamics, inverse_dynamics
from . import by_hand
from .by_hand import Links, Matrices

__all__ = ["CASES", "Case", "ForwardDynamics", "FreeBody", "InverseDynamics", "OfChain", "numbers"]

Array = NDArray[np.float64]
#: x, u and params of a call of the dynamics.
Inputs = tuple[dict[str, Any], dict[str, Any], dict[str, Any]]


class Case(ABC):
    """A function of three vectors to one. Derivatives are by the first two.

    Attributes:
        name: on the command line.
        title: on the page.
        sizes: of the arguments.
        results: length of the result.
    """

    name: str
    title: str
    sizes: tuple[int, int, int]
    results: int

    @property
    def columns(self) -> int:
        """Of the Jacobian."""
        return self.sizes[0] + self.sizes[1]

    def points(self, count: int) -> tuple[Array, Array, Array]:
        """Random arguments, (count, size) each; the first ones are the same for every count."""
        drawn = np.random.default_rng(20240611).normal(size=(count, sum(self.sizes)))
        a, b, c = np.split(drawn, np.cumsum(self.sizes)[:-1], axis=1)
        return self._valid(a), b, c

    def _valid(self, a: Array) -> Array:
        return a

    @abstractmethod
    def system(self) -> tx.System:
        """With our own nodes; made anew on each call."""

    @abstractmethod
    def inputs(self, a: Any, b: Any, c: Any) -> Inputs:
        """The three vectors as x, u and params of the system."""

    @property
    @abstractmethod
    def rates(self) -> tuple[str, ...]:
        """The states whose rates, one after the other, are the result."""

    @property
    @abstractmethod
    def by(self) -> tuple[str, ...]:
        """What `dynamics.jacobian` takes derivatives by, in the order of the arguments."""

    @abstractmethod
    def by_hand(self, m: Matrices, a: Any, b: Any, c: Any) -> list[Any]:
        """The result in plain matrices, in as many vectors as `rates` has names."""


class FreeBody(Case):
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

    def _valid(self, a: Array) -> Array:
        length = np.linalg.norm(a[:, 3:], axis=1, keepdims=True)
        return np.concatenate([a[:, :3], a[:, 3:] / length], axis=1)

    def system(self) -> tx.System:
        y, V, F = tx.State("y", shape=(7,)), tx.State("V", shape=(6,)), tx.Control("F", shape=(6,))
        v, w, q = V[:3], V[3:], y[3:]
        R = tx.spatial.QDCM(q)
        pose = tx.Block([[R, np.zeros((3, 1))], [np.zeros((1, 3)), np.ones((1, 1))]])
        wrench = F + self.body.weight(pose, np.array([0.0, 0.0, -9.81]))
        moved = tx.Concat(R @ v, 0.5 * tx.spatial.SSMP(w) @ q)
        return tx.System(rates={y: moved, V: self.body.acceleration(V, wrench)})

    def inputs(self, a: Any, b: Any, c: Any) -> Inputs:
        return {"y": a, "V": b}, {"F": c}, {}

    def by_hand(self, m: Matrices, a: Any, b: Any, c: Any) -> list[Any]:
        return by_hand.free_body(m, self.inertia, self.mass_moment, a, b, c)


class OfChain(Case):
    """A function of positions, velocities and a third vector of a chain."""

    rates, by = ("qd",), ("u", "x")

    def __init__(self, name: str, title: str, links: int, model: Callable[[], Chain]) -> None:
        self.name, self.title, self._model = name, title, model
        self.sizes, self.results = (links, links, links), links

    @functools.cached_property
    def chain(self) -> Chain:
        """Made when first asked for: the command line only needs names."""
        return self._model()

    @functools.cached_property
    def links(self) -> Links:
        return [(numbers(link.mount), numbers(link.body.matrix)) for link in self.chain.links]

    def system(self) -> tx.System:
        n = self.results
        q, qd = tx.Control("q", shape=(n,)), tx.State("qd", shape=(n,))
        third = tx.Parameter("third", shape=(n,), value=np.zeros(n))
        return tx.System(rates={qd: self.written(q, qd, third)}, parameters=[third])

    @abstractmethod
    def written(self, q: tx.Expr, qd: tx.Expr, third: tx.Expr) -> tx.Expr:
        """The result with our own nodes."""

    def inputs(self, a: Any, b: Any, c: Any) -> Inputs:
        return {"qd": b}, {"q": a}, {"third": c}


class InverseDynamics(OfChain):
    """Forces of the motors, of positions, velocities and accelerations."""

    def written(self, q: tx.Expr, qd: tx.Expr, third: tx.Expr) -> tx.Expr:
        return inverse_dynamics(self.chain, q, qd, third)

    def by_hand(self, m: Matrices, a: Any, b: Any, c: Any) -> list[Any]:
        return [by_hand.inverse_dynamics(m, self.links, a, b, c)]


class ForwardDynamics(OfChain):
    """Accelerations, of positions, velocities and forces of the motors."""

    def written(self, q: tx.Expr, qd: tx.Expr, third: tx.Expr) -> tx.Expr:
        return forward_dynamics(self.chain, q, qd, third)

    def by_hand(self, m: Matrices, a: Any, b: Any, c: Any) -> list[Any]:
        return [by_hand.forward_dynamics(m, self.links, a, b, c)]


def numbers(value: Any) -> Array:
    """A constant expression as an array, also while something is traced."""
    with jax.ensure_compile_time_eval():
        return np.asarray(tx.lower(value)(0.0, {}), np.float64)


def _cases() -> list[Case]:
    arm, rods = chain_models.panda, functools.partial(chain_models.equal_links, 30)
    return [
        FreeBody(),
        InverseDynamics("rnea-7", "RNEA, 7 links", 7, arm),
        ForwardDynamics("aba-7", "ABA, 7 links", 7, arm),
        InverseDynamics("rnea-30", "RNEA, 30 links", 30, rods),
        ForwardDynamics("aba-30", "ABA, 30 links", 30, rods),
    ]


#: By name.
CASES: dict[str, Case] = {case.name: case for case in _cases()}
