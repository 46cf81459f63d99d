"""Terms: small trees of text that become an expression, a number by NumPy, and code that a person can run."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import twistax as tx

Shape = tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Term:
    """One operation over other terms.

    Attributes:
        code: the expression as Python code, with a field {0}, {1}, ... for each operand.
        numpy: the same by NumPy, on the values of the operands.
        args: the operands. A term that stands in two places is one subexpression there.
        shape: of the value.
        leaf: the name, where this is a state, a control or a parameter.
        setup: statements that the code needs before it, such as a class of the user's.
        rounding: of the operands' values, as that of a plan.
    """

    code: str
    numpy: Callable[..., Any]
    args: tuple[Term, ...]
    shape: Shape
    leaf: str = ""
    setup: str = ""
    rounding: Callable[..., Any] | None = None

    def walk(self) -> Iterator[Term]:
        """Operands before what is made of them, each one once."""
        seen: set[int] = set()
        stack = [(self, False)]
        while stack:
            term, entered = stack.pop()
            if entered:
                yield term
            elif id(term) not in seen:
                seen.add(id(term))
                stack.append((term, True))
                stack.extend((arg, False) for arg in reversed(term.args))

    def size(self) -> int:
        return sum(1 for _ in self.walk())

    def value(self, leaves: Mapping[str, Any], noise: Callable[[Any, Any], Any] | None = None) -> tuple[Any, list[Any]]:
        """By NumPy: the value, and all that was met on the way.

        Args:
            noise: put on each result: of its value, and of how far rounding may move it beyond a few last places.
        """
        values: dict[int, Any] = {}
        for term in self.walk():
            if term.leaf:
                values[id(term)] = np.asarray(leaves[term.leaf])
                continue
            operands = [values[id(arg)] for arg in term.args]
            values[id(term)] = term.numpy(*operands)
            if noise is not None:
                far = 0.0 if term.rounding is None else term.rounding(*operands)
                values[id(term)] = noise(values[id(term)], far)
        return values[id(self)], list(values.values())

    def replaced(self, old: Term, new: Term) -> Term:
        """This term with another one in place of one of its parts, everywhere."""
        made: dict[int, Term] = {}
        for term in self.walk():
            args = tuple(made[id(arg)] for arg in term.args)
            same = all(a is b for a, b in zip(args, term.args, strict=True))
            made[id(term)] = new if term is old else term if same else replace(term, args=args)
        return made[id(self)]


@dataclass(frozen=True)
class Case:
    """Terms, the leaves' values, and how the system of them is to be compiled.

    Attributes:
        terms: what is computed.
        leaves: value of each leaf.
        baked: parameters given as constants to `tx.compile`.
        batched: whether it is one of a batch.
        single: whether the leaves are given in single precision.
        differentiated: whether derivatives are compared too.
        whole: whether leaves of whole numbers are given as integers.
        narrow: whether JAX works in 32 bits.
        extreme: whether results count at the ends of the range and at NaN too.
        called: whether each path is called as users do; else all of them are in one jitted function.
        more: other values of the leaves, for which the same programs are called.
    """

    terms: tuple[Term, ...]
    leaves: dict[str, np.ndarray]
    baked: tuple[str, ...] = ()
    batched: bool = False
    single: bool = False
    differentiated: bool = False
    whole: bool = False
    narrow: bool = False
    extreme: bool = False
    called: bool = False
    more: tuple[dict[str, np.ndarray], ...] = ()

    def points(self) -> list[Case]:
        """The case for each set of values by itself."""
        return [replace(self, leaves=leaves, more=()) for leaves in (self.leaves, *self.more)]

    def walk(self) -> Iterator[Term]:
        """All terms, each once, operands first."""
        return iter({id(part): part for term in self.terms for part in term.walk()}.values())

    def used(self) -> dict[str, np.ndarray]:
        names = {term.leaf for term in self.walk() if term.leaf}
        return {name: value for name, value in self.leaves.items() if name in names}

    @property
    def settings(self) -> tuple[str, ...]:
        names = ("batched", "single", "differentiated", "whole", "narrow", "extreme", "called")
        return tuple(name for name in names if getattr(self, name))

    @property
    def dtype(self) -> Any:
        """That of the results."""
        return np.float32 if self.single or self.narrow else np.float64

    def given(self, name: str) -> Any:
        """A leaf's value as it is given: an array, or whole numbers as Python has them."""
        value = self.leaves[name]
        if self.whole and np.all(np.isfinite(value)) and np.array_equal(value, np.round(value)):
            return value.astype(np.int64).tolist()
        with np.errstate(over="ignore"):  # infinite in single precision
            return value.astype(self.dtype)

    def lines(self) -> list[str]:
        """The code: a line for each operation; the last one, `e`, is a tuple of all terms."""
        names: dict[int, str] = {}
        lines: list[str] = []
        for term in self.walk():
            text = term.code.format(*(names[id(arg)] for arg in term.args))
            if term.setup and term.setup not in lines:
                lines.append(term.setup)
            names[id(term)] = term.leaf or f"e{len(names)}"
            lines.append(f"{names[id(term)]} = {text}")
        return [*lines, f"e = ({', '.join(names[id(term)] for term in self.terms)},)"]

    @cached_property
    def expressions(self) -> list[tx.Expr]:
        """What a user's code builds."""
        scope: dict[str, Any] = dict(SCOPE)
        exec("\n".join(self.lines()), scope)
        return [tx.expr.to_expr(each) for each in scope["e"]]

    def as_code(self) -> str:
        """A script that builds the expressions and prints their values."""
        lines = ["import jax", "import jax.numpy as jnp", "import numpy as np", "import twistax as tx"]
        lines += [f'jax.config.update("jax_enable_x64", {not self.narrow})', *self.lines()]
        for point in self.points():
            for kind in "scp":  # states, controls, parameters
                own = {name: np.asarray(point.given(name)).tolist() for name in point.used() if name[0] == kind}
                entries = re.sub(r"\b(nan|inf)\b", r"np.\1", repr(own))
                lines.append(f"{kind} = {entries}")
            lines.append("print(*tx.lower(tuple(map(tx.expr.to_expr, e)))(0.0, s, c, p))")
        how = [f"baked: {', '.join(self.baked)}"] * bool(self.baked) + list(self.settings)
        return "\n".join([*lines, f"# {'; '.join(how)}" if how else "# as it is"])


SCOPE = {"tx": tx, "np": np, "jnp": jnp, "jax": jax}
