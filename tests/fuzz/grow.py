"""Random terms and the values of their leaves, every choice from one source."""

from __future__ import annotations

from random import Random

import numpy as np
import users_nodes  # noqa: F401, adds its maker
from operations import MAKERS
from term import Case, Shape, Term

SHAPES: list[Shape] = [(), (), (1,), (2,), (3,), (3,), (4,), (6,), (2, 2), (2, 3), (3, 3), (4, 4), (3, 1), (2, 2, 3)]
KINDS = ("State", "Control", "Parameter")
#: Where rewrites, folding and reductions of ranges go wrong.
SPECIAL = (0.0, -0.0, 1.0, -1.0, 0.5, 2.0, np.pi / 2, 1e-8, 1e-160, 5e-324, 1e160, np.inf, -np.inf)


class Grower:
    """Grows cases. `special` is the share of leaves that hold numbers at which things go wrong."""

    def __init__(self, source: Random, special: float) -> None:
        self.source = source
        self.special = special
        self.leaves: dict[str, np.ndarray] = {}
        self.made: dict[Shape, list[Term]] = {}

    def case(self, depth: int) -> Case:
        term = self.term(self.source.choice(SHAPES), depth)
        parameters = [name for name in self.leaves if name.startswith("p")]
        baked = tuple(name for name in parameters if self.source.random() < 0.3)
        batched, single, differentiated = (self.source.random() < share for share in (0.4, 0.15, 0.35))
        return Case(term, self.leaves, baked, batched, single, differentiated)

    def term(self, shape: Shape, depth: int) -> Term:
        older = self.made.setdefault(shape, [])
        if older and self.source.random() < 0.15:
            return self.source.choice(older)  # shared
        if depth <= 0 or self.source.random() < 0.08:
            made = self.constant(shape) if self.source.random() < 0.2 else self.leaf(shape)
        else:
            plan = None
            while plan is None:
                plan = self.source.choice(MAKERS)(self.source, shape)
            made = Term(
                plan.code, plan.numpy, tuple(self.term(arg, depth - 1) for arg in plan.args), shape, setup=plan.setup
            )
        older.append(made)
        return made

    def leaf(self, shape: Shape) -> Term:
        kind = self.source.choice(KINDS)
        name = f"{kind[0].lower()}{len(self.leaves)}"
        self.leaves[name] = self.array(shape)
        return Term(f'tx.{kind}("{name}", shape={shape})', np.asarray, (), shape, leaf=name)

    def constant(self, shape: Shape) -> Term:
        n = shape[0] if shape else 1
        value = self.source.choice([np.zeros(shape), np.ones(shape), self.array(shape)])
        if shape == (n, n) and self.source.random() < 0.5:
            value = np.eye(n)
        return Term(f"tx.Constant(np.array({value.tolist()!r}))".replace("inf", "np.inf"), lambda: value, (), shape)

    def array(self, shape: Shape) -> np.ndarray:
        """Quarters, exact in binary: comparisons of leaves do not hang on rounding."""
        size = int(np.prod(shape))
        entries = [self.source.randint(-10, 10) / 4.0 for _ in range(size)]
        if self.source.random() < self.special:
            entries = [self.source.choice(SPECIAL) if self.source.random() < 0.5 else entry for entry in entries]
        return np.array(entries, float).reshape(shape)
