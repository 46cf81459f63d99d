"""Random terms and the values of their leaves, every choice from one source."""

from __future__ import annotations

from random import Random

import numpy as np
from operations import MAKERS, Graded, Operand, Plan, extreme
from term import Case, Shape, Term
from users_nodes import ANY, AXIS, around

SHAPES: list[Shape] = [
    (),
    (),
    (1,),
    (2,),
    (3,),
    (3,),
    (4,),
    (6,),
    (2, 2),
    (2, 3),
    (3, 3),
    (4, 4),
    (3, 1),
    (2, 2, 3),
    (6, 6),
]
KINDS = ("State", "Control", "Parameter")
#: Where rewrites, folding and reductions of ranges go wrong.
SPECIAL = (0.0, -0.0, 1.0, -1.0, 0.5, 2.0, np.pi / 2, 1e-8, 1e-160, 5e-324, 1e160, np.inf, -np.inf)
#: Where single operations end: of double precision, and of single precision, whose squares overflow at 2e19.
ENDS = (0.0, 1.0, -2.5, np.nan, np.inf, -np.inf, 1e160, -1e200, 1e300, 1e-100)
ENDS_SINGLE = (0.0, 1.0, -2.5, np.nan, np.inf, -np.inf, 2e19, -1e25, 1e38, 1e-12)
#: Beyond 32 bits, and beyond the digits of single precision.
WHOLE = (398600441800000, -3000000000, 2**31, 16777217, 7, 0, 2)
#: Terms that are compiled together: most of the time is spent for each compilation, not for what is in it.
TOGETHER = 6


def drawn(seed: int, number: int) -> Case:
    """One case of a run, the same whatever came before it."""
    source = Random(f"{seed}:{number}")
    if number % 5 == 4:
        return Grower(source).extremes()
    if number % 5 == 3:
        return Grower(source).users(seed, number // 5)
    return Grower(source, special=0.2 if number % 2 else 0.0).case(TOGETHER, depth=(1, 2, 1, 3)[number % 4])


class Grower:
    """Grows cases. `special` is the share of leaves that hold numbers at which things go wrong."""

    def __init__(self, source: Random, special: float = 0.0) -> None:
        self.source = source
        self.special = special
        self.numbers: tuple[float, ...] = SPECIAL
        self.leaves: dict[str, np.ndarray] = {}
        self.made: dict[Shape, list[Term]] = {}

    def case(self, count: int, depth: int) -> Case:
        single, narrow, differentiated = (self.source.random() < share for share in (0.12, 0.1, 0.25))
        whole = not single and (narrow or self.source.random() < 0.1)
        if whole and self.source.random() < 0.5:
            self.numbers, self.special = WHOLE, 0.4
        batched = not whole and self.source.random() < 0.4
        terms = tuple(self.term(self.source.choice(SHAPES), depth) for _ in range(count))
        parameters = [name for name in self.leaves if name.startswith("p")]
        baked = tuple(name for name in parameters if self.source.random() < 0.5)
        return Case(terms, self.leaves, baked, batched, single, differentiated and not (whole or narrow), whole, narrow)

    def extremes(self) -> Case:
        """Single operations of leaves, at the ends of the range."""
        single = self.source.random() < 0.3
        self.numbers, self.special = (ENDS_SINGLE if single else ENDS), 1.0
        terms = []
        for _ in range(TOGETHER):
            plan = extreme(self.source, (3,))
            args = tuple(self.leaf(arg) for arg in plan.args)  # type: ignore[arg-type]
            terms.append(Term(plan.code, plan.numpy, args, (3,)))
        return Case(tuple(terms), self.leaves, batched=self.source.random() < 0.4, single=single, extreme=True)

    def users(self, seed: int, turn: int) -> Case:
        """Nodes of users of leaves: all of them, a few at a time, in an order of the seed's own."""
        bodies = Random(seed).sample(ANY + AXIS, len(ANY + AXIS))
        count = 2 * TOGETHER
        shape = self.source.choice([(3,), (4,), (2, 3), (3, 3)])
        plans = [around(bodies[(turn * count + k) % len(bodies)], shape) for k in range(count)]
        terms = tuple(Term(plan.code, plan.numpy, (self.leaf(shape),), shape, setup=plan.setup) for plan in plans)
        batched, differentiated = (self.source.random() < share for share in (0.4, 0.25))
        return Case(terms, self.leaves, batched=batched, differentiated=differentiated)

    def term(self, shape: Shape, depth: int) -> Term:
        older = self.made.setdefault(shape, [])
        if older and self.source.random() < 0.15:
            return self.source.choice(older)  # shared
        if depth <= 0 or self.source.random() < 0.08:
            made = self.constant(shape) if self.source.random() < 0.2 else self.leaf(shape)
        else:
            made = self.operation(shape, depth)
        older.append(made)
        return made

    def operation(self, shape: Shape, depth: int) -> Term:
        plan = None
        while plan is None:
            plan = self.source.choice(MAKERS)(self.source, shape)
        args: list[Term] = []
        for arg in plan.args:
            args.append(self.operand(arg, args, depth - 1))
        return Term(plan.code, plan.numpy, tuple(args), shape, setup=plan.setup)

    def operand(self, wanted: Operand, before: list[Term], depth: int) -> Term:
        if isinstance(wanted, Plan):
            return Term(wanted.code, wanted.numpy, tuple(before), wanted.shape)
        return self.leaf((wanted.n, wanted.n), wanted) if isinstance(wanted, Graded) else self.term(wanted, depth)

    def leaf(self, shape: Shape, graded: Graded | None = None) -> Term:
        kind = self.source.choice(KINDS)
        name = f"{kind[0].lower()}{len(self.leaves)}"
        self.leaves[name] = self.array(shape) if graded is None else graded.matrix(self.source)
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
        if self.numbers is WHOLE:
            entries = [round(entry) for entry in entries]
        elif self.source.random() < 0.3:
            entries = [0.4 * entry for entry in entries]  # which no precision has
        if self.source.random() < self.special:
            entries = [self.source.choice(self.numbers) if self.source.random() < 0.5 else entry for entry in entries]
        return np.array(entries, float).reshape(shape)
