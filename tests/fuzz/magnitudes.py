"""Expressions at physical magnitudes in single precision: values, Jacobians and Hessians on every path.

The oracle is a running error analysis in double precision: each number comes with the sum of the absolute values of
its terms, to first order, so that sums may cancel. A case counts where single precision can hold all values and all
derivatives of its parts.
Source: Higham, Accuracy and Stability of Numerical Algorithms (2002), section 3.3.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from random import Random
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from paths import BACKENDS

import twistax as tx
from twistax.jax_inside import quick_compile

#: Entries of the state: two positions, a mass and an inertia. As many expressions are its rate.
SIZE = 8
#: How many expressions are drawn for each.
COUNT = 6
#: An error may be so many eps times the sum of absolute values.
BAR = 100.0
#: Beyond these single precision does not hold a number, or only parts of a sum of a few of them.
LEAST, LARGEST = 1e-36, 1e36
#: Constants and orders of magnitude.
GM = (4e14, 1.3e20, 6.67e-11)


@dataclass(frozen=True, eq=False)
class Number:
    """A number with its first two derivatives, and for each the sum of absolute values of its terms.

    Attributes:
        parts: the numbers that it is made of, with its slopes by them, and how these change with the state.
    """

    value: float
    slope: np.ndarray
    curvature: np.ndarray
    sums: tuple[float, np.ndarray, np.ndarray]
    parts: tuple[tuple[Number, float, np.ndarray], ...] = ()

    def holds(self) -> bool:
        """Whether single precision holds it, its derivatives, and the terms of these."""
        return representable(
            np.concatenate([np.ravel(a) for a in (self.value, self.slope, self.curvature, *self.sums)])
        )


def leaf(value: float, place: int) -> Number:
    zero = np.zeros((SIZE, SIZE))
    return Number(value, np.eye(SIZE)[place], zero, (0.0, np.zeros(SIZE), zero))


def constant(value: float) -> Number:
    zero = np.zeros((SIZE, SIZE))
    return Number(value, np.zeros(SIZE), zero, (abs(value), np.zeros(SIZE), zero))


def add(a: Number, b: Number) -> Number:
    value, slope = a.value + b.value, a.slope + b.slope
    sums = (abs(a.value) + abs(b.value), np.abs(a.slope) + np.abs(b.slope), np.abs(a.curvature) + np.abs(b.curvature))
    whole = tuple(x + y + z for x, y, z in zip(a.sums, b.sums, sums, strict=True))
    return Number(value, slope, a.curvature + b.curvature, whole, ((a, 1.0, np.zeros(SIZE)), (b, 1.0, np.zeros(SIZE))))


def mul(a: Number, b: Number) -> Number:
    def second(a: Any, b: Any, da: Any, db: Any, dda: Any, ddb: Any) -> Any:
        return dda * b + a * ddb + np.outer(da, db) + np.outer(db, da)

    def of(a: Sequence[Any], b: Sequence[Any]) -> tuple[Any, Any, Any]:
        return a[0] * b[0], a[1] * b[0] + a[0] * b[1], second(a[0], b[0], a[1], b[1], a[2], b[2])

    exact = [(n.value, n.slope, n.curvature) for n in (a, b)]
    large = [tuple(map(np.abs, n)) for n in exact]
    parts = (of(*large), of(a.sums, large[1]), of(large[0], b.sums))
    sums = tuple(sum(each) for each in zip(*parts, strict=True))
    return Number(*of(*exact), sums, ((a, b.value, b.slope), (b, a.value, a.slope)))


def applied(derivatives: Sequence[float], a: Number) -> Number:
    """A function with its first three derivatives at a number."""
    f = [float(each) for each in derivatives]
    size, (off, off_slope, off_curvature) = np.abs(f), a.sums
    g, h, G, H = a.slope, a.curvature, np.abs(a.slope), np.abs(a.curvature)
    first = size[1] + size[2] * off
    sums = (
        size[0] + size[1] * off,
        first * G + size[1] * off_slope,
        (size[2] + size[3] * off) * np.outer(G, G)
        + size[2] * (np.outer(off_slope, G) + np.outer(G, off_slope))
        + first * H
        + size[1] * off_curvature,
    )
    return Number(f[0], f[1] * g, f[2] * np.outer(g, g) + f[1] * h, sums, ((a, f[1], f[2] * g),))


def power(a: Number, n: float, holds: bool = True) -> Number:
    """x^n; NaN where single precision does not hold x."""
    x = np.float64(a.value if holds else np.nan)
    return applied([x**n, n * x ** (n - 1), n * (n - 1) * x ** (n - 2), n * (n - 1) * (n - 2) * x ** (n - 3)], a)


def adjoints_hold(root: Number, order: int) -> bool:
    """Whether single precision holds the terms of the derivatives of a number by all of its parts.

    Reverse modes pass these from the number to the state. Second derivatives take how they change with the state too.
    """
    parts: dict[int, Number] = {}

    def visit(number: Number) -> None:
        if id(number) not in parts:
            for part, *_ in number.parts:
                visit(part)
            parts[id(number)] = number

    visit(root)
    found = {id(root): (1.0, np.zeros(SIZE))}
    for number in reversed(list(parts.values())):
        size, change = found[id(number)]
        for part, slope, bend in number.parts:
            terms = [np.ravel(size * slope)] + ([change * slope, size * bend] if order == 2 else [])
            if not representable(np.concatenate(terms)):
                return False
            before = found.get(id(part), (0.0, np.zeros(SIZE)))
            found[id(part)] = (before[0] + size * slope, before[1] + change * slope + size * bend)
    return all(
        representable(np.append(change, size) if order == 2 else np.array(size)) for size, change in found.values()
    )


def representable(entries: np.ndarray) -> bool:
    """Whether single precision holds numbers and sums of a few of them."""
    sizes = np.abs(entries[entries != 0.0])
    return bool(np.all(np.isfinite(entries)) and np.all(sizes > LEAST) and np.all(sizes < LARGEST))


# ---- expressions -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Part:
    """One expression: its number, and a function that makes it of the leaves by any arithmetic.

    Attributes:
        canonical: the number by way of the parts of the canonical expression, where products of products are one.
        factors: of a product in the order in which the canonical one is formed, the constant first.
    """

    number: Number
    canonical: Number
    make: Callable[[Any], Any]
    text: str
    factors: tuple[Number, ...] = ()

    def holds(self) -> bool:
        """Whether single precision holds it, either way."""
        prefixes = [functools.reduce(mul, self.factors[:k]) for k in range(1, len(self.factors))]
        # On arrays XLA may multiply by the number last.
        moving = [functools.reduce(mul, self.factors[k:]) for k in range(1, min(2, len(self.factors)))]
        return all(number.holds() for number in (self.number, self.canonical, *prefixes, *moving))


def made(rule: Callable[..., Number], make: Callable[[Any], Any], text: str, *of: Part) -> Part:
    """The part of an operation on others."""
    return Part(rule(*(a.number for a in of)), rule(*(a.canonical for a in of)), make, text)


def product(a: Part, b: Part, make: Callable[[Any], Any], text: str) -> Part:
    """That of a product."""
    every = [n for part in (a, b) for n in part.factors or (part.canonical,)]
    fixed = [n for n in every if not np.any(n.slope)]
    factors = [functools.reduce(mul, fixed)] if fixed else []
    factors += [n for n in every if np.any(n.slope)]
    return Part(mul(a.number, b.number), functools.reduce(mul, factors), make, text, tuple(factors))


class Arithmetic:
    """Of arrays of JAX."""

    norm, dot, sqrt = map(staticmethod, (jnp.linalg.norm, jnp.dot, jnp.sqrt))


class Nodes:
    """Of expressions."""

    norm, dot, sqrt = tx.linalg.Norm, tx.linalg.Dot, tx.Sqrt


def drawn(seed: int, number: int) -> tuple[np.ndarray, list[Part]]:
    """A state, and expressions that single precision holds."""
    source = Random(f"magnitudes:{seed}:{number}")
    size = 10.0 ** source.uniform(-9.0, 15.0)
    sizes = [source.choice((size, 7e6, 10.0 ** source.uniform(-9.0, 15.0))) for _ in range(2)]
    state = np.array([source.uniform(0.2, 1.0) * source.choice((-1, 1)) * sizes[k // 3] for k in range(6)])
    state = np.append(state, [10.0 ** source.uniform(-6.0, 6.0) for _ in range(2)]).astype(np.float32)
    grower = Grower(source, state.astype(float))
    parts: list[Part] = []
    while len(parts) < COUNT:
        part = grower.scalar(source.randint(1, 4))
        if part.holds() and np.any(part.number.slope):
            parts.append(part)
    return state, parts


class Grower:
    def __init__(self, source: Random, state: np.ndarray) -> None:
        self.source, self.state = source, state
        self.leaves = [leaf(value, k) for k, value in enumerate(state.tolist())]

    def entry(self, k: int) -> Part:
        return made(lambda: self.leaves[k], lambda c, k=k: c[0][k], f"z[{k}]")

    def size(self) -> Part:
        """A distance, or its square."""
        first = self.source.choice((0, 3))
        own, text = slice(first, first + 3), f"z[{first}:{first + 3}]"
        square = functools.reduce(add, (mul(n, n) for n in self.leaves[own]))
        if self.source.random() < 0.4:
            return made(lambda: square, lambda c, own=own: c[1].dot(c[0][own], c[0][own]), f"dot({text}, {text})")
        root = power(square, 0.5, square.holds())
        return made(lambda: root, lambda c, own=own: c[1].norm(c[0][own]), f"norm({text})")

    def scalar(self, depth: int) -> Part:
        source = self.source
        while True:
            part = (
                self.grown(depth) if depth else source.choice((self.size, lambda: self.entry(source.randrange(SIZE))))()
            )
            if part.holds():
                return part
            depth = max(depth - 1, 0)

    def grown(self, depth: int) -> Part:
        source, kind = self.source, self.source.randrange(7)
        a = self.scalar(depth - 1)
        if kind == 0:
            n = source.choice((-6, -4, -3, -3, -2, -2, -1, 2, 3, 5))
            return made(lambda a: power(a, n), lambda c: a.make(c) ** n, f"({a.text}) ** {n}", a)
        if kind == 1:
            n = source.choice((-1.5, -0.5, 1.5, 2.5))
            square = self.size()
            return made(lambda a: power(a, n), lambda c: square.make(c) ** n, f"({square.text}) ** {n}", square)
        if kind == 2:
            factor = source.choice(GM)
            fixed = made(lambda: constant(factor), lambda c: factor, f"{factor}")
            return product(fixed, a, lambda c: factor * a.make(c), f"{factor} * ({a.text})")
        if kind == 3:
            square = product(a, a, lambda c: a.make(c) * a.make(c), f"({a.text})^2")
            holds = square.holds()
            return made(
                lambda n: power(n, 0.5, holds), lambda c: c[1].sqrt(square.make(c)), f"sqrt({square.text})", square
            )
        b = self.scalar(depth - 1)
        if kind == 4:
            return product(a, b, lambda c: a.make(c) * b.make(c), f"({a.text}) * ({b.text})")
        if kind == 5:
            return made(
                lambda a, b: mul(a, power(b, -1)), lambda c: a.make(c) / b.make(c), f"({a.text}) / ({b.text})", a, b
            )
        return made(add, lambda c: a.make(c) + b.make(c), f"({a.text}) + ({b.text})", a, b)


# ---- the paths -------------------------------------------------------------------------------------------------------


def rate_of(z: tx.Expr, parts: Sequence[Part]) -> tx.Expr:
    """The expressions as the rate of the state."""
    return tx.Concat(*(part.make((z, Nodes)) for part in parts), np.zeros(SIZE - len(parts)))


def paths(parts: Sequence[Part], by: str) -> Iterator[tuple[str, int, Callable[[jax.Array], jax.Array]]]:
    """The paths by a backend: the name, of which order the derivative is, and a function of the state that gives it.

    The order is negative in modes that pass derivatives by all parts of an expression.
    """
    z = tx.State("z", shape=(SIZE,))
    rate = rate_of(z, parts)
    lowered = tx.lower(rate)
    plain = lambda z: jnp.stack([part.make((z, Arithmetic)) for part in parts])  # noqa: E731
    dynamics = tx.compile(tx.System({z: rate}), backend=BACKENDS[by])
    yield f"{by}, jacobian", 1, lambda z: dynamics.jacobian(0.0, {"z": z})["x"]
    weighted = lambda z, unit: dynamics.hessian(0.0, {"z": z}, None, None, {"z": unit}, wrt=("x",))  # noqa: E731
    yield f"{by}, hessian", -2, lambda z: jax.vmap(functools.partial(weighted, z))(jnp.eye(SIZE, dtype=z.dtype))
    functions = {by: lambda z: dynamics(0.0, {"z": z})["z"]}
    if by == "arrays":
        functions["tx.lower"] = lambda z: lowered(0.0, {"z": z})
    else:
        functions[f"fast, {by}"] = tx.fast(plain, backend=BACKENDS[by])
        yield f"fast of jacfwd, {by}", 1, tx.fast(jax.jacfwd(plain), backend=BACKENDS[by])
    for name, function in functions.items():
        yield name, 0, function
        yield f"{name}, jacfwd", 1, jax.jacfwd(function)
        yield f"{name}, jacrev", -1, jax.jacrev(function)
        yield f"{name}, jacfwd of jacfwd", 2, jax.jacfwd(jax.jacfwd(function))
        yield f"{name}, hessian of JAX", -2, jax.hessian(function)


def wrong(state: np.ndarray, parts: Sequence[Part], by: str) -> str:
    """What is wrong by a backend, in a line for each path; nothing if nothing is."""
    every = list(paths(parts, by))
    together = jax.jit(lambda z: [function(z) for _, _, function in every], compiler_options=quick_compile(0))
    results = together(jnp.asarray(state))
    said = [off(name, order, np.asarray(r), parts) for (name, order, _), r in zip(every, results, strict=True)]
    return "\n".join(filter(None, said))


def off(name: str, order: int, result: np.ndarray, parts: Sequence[Part]) -> str:
    """What is wrong on a path with the derivatives of an order, in a line; nothing if nothing is."""
    eps = float(np.finfo(result.dtype).eps)
    for k, part in enumerate(parts):
        number = part.number
        if order < 0 and not all(adjoints_hold(each, -order) for each in (number, part.canonical)):
            continue
        right = (number.value, number.slope, number.curvature)[abs(order)]
        error = np.abs(result[k].astype(float) - right)
        # The oracle itself has the eps of double precision.
        if not np.all(error <= BAR * eps * number.sums[abs(order)] + LEAST / 10):
            return f"{name}: {part.text}: {result[k].tolist()} for {np.asarray(right).tolist()}"
    return ""
