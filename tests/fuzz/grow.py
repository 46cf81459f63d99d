"""Random terms and the values of their leaves, every choice from one source."""

from collections.abc import Callable
from functools import cache
from random import Random
from typing import Any

import elementwise
import groups_of_motion
import matrices
import movement
import numpy as np
import tabulated
import users_nodes
from plans import MAKERS, Graded, Maker, Operand, Plan
from term import Case, Shape, Term

#: Where operations are: importing them fills `MAKERS`.
AREAS = (elementwise, matrices, movement, tabulated, groups_of_motion, users_nodes)

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
TOGETHER, TREES = 20, 8
#: Cases before the first trees.
FIRST = 36
#: How many operations of one maker come in a round, and after how many draws without a new one it has no more.
MOST, DRAWS = 100, 60
#: Sets of values of the leaves for the programs of one case: to call them again takes little. And the share of leaves
#: of the others that hold numbers at which things go wrong.
POINTS, OTHERS = 4, 0.25


def drawn(seed: int, number: int) -> Case:
    """One case of a run, the same whatever came before it: every operation alone, round after round, and trees.

    The first round comes without trees: most errors are of single operations.
    """
    source = Random(f"{seed}:{number}")
    trees, turn = number >= FIRST and number % 4 == 3, number if number < FIRST else number - (number - FIRST) // 4
    if trees:
        return Grower(source, special=0.2 if number % 8 == 3 else 0.0).trees(depth=(2, 1, 3)[number % 3])
    if turn % 6 == 1:
        return Grower(source).extremes(dealt("extremes", seed, turn // 6))
    return Grower(source, special=source.choice((0.0, 0.25))).alone(dealt("operations", seed, turn - (turn + 4) // 6))


def dealt(deck: str, seed: int, turn: int) -> list[tuple[Plan, Shape]]:
    """The hand of a turn."""
    rounds = 0
    while turn >= len(hands := _dealt(deck, seed, rounds)):
        turn, rounds = turn - len(hands), rounds + 1
    return hands[turn]


@cache
def _dealt(deck: str, seed: int, rounds: int) -> list[list[tuple[Plan, Shape]]]:
    """The hands of a round, in which each operation comes once."""
    source = Random(f"{deck}:{seed}:{rounds}")
    makers = dict.fromkeys(MAKERS)
    cards = elementwise.extremes((6,)) if deck == "extremes" else [card for own in makers for card in made(source, own)]
    source.shuffle(cards)
    count = -(-len(cards) // TOGETHER)
    return [cards[k::count] for k in range(count)]


def made(source: Random, maker: Maker) -> list[tuple[Plan, Shape]]:
    """The different operations of one maker, each with a shape that it gives."""
    found: dict[Any, tuple[Plan, Shape]] = {}
    missed = 0
    while missed < DRAWS and len(found) < MOST:
        shape = source.choice(SHAPES)
        plan = maker(source, shape)
        known = len(found)
        if plan is not None:
            own = (
                arg.code if isinstance(arg, Plan) else (arg, shape) for arg in plan.args if not isinstance(arg, tuple)
            )
            found.setdefault((plan.code, *own), (plan, shape))
        missed = 0 if len(found) > known else missed + 1
    return list(found.values())


class Grower:
    """Grows cases. `special` is the share of leaves that hold numbers at which things go wrong."""

    def __init__(self, source: Random, special: float = 0.0) -> None:
        self.source = source
        self.special = special
        self.numbers: tuple[float, ...] = SPECIAL
        self.leaves: dict[str, np.ndarray] = {}
        self.wanted: dict[str, Shape | Graded] = {}
        self.made: dict[Shape, list[Term]] = {}

    def trees(self, depth: int) -> Case:
        return self.case(lambda: [self.term(self.source.choice(SHAPES), depth) for _ in range(TREES)], derived=0.25)

    def alone(self, hand: list[tuple[Plan, Shape]]) -> Case:
        """Single operations of leaves."""
        return self.case(lambda: [self.planned(plan, shape, 0) for plan, shape in hand], derived=0.3)

    def case(self, grown: Callable[[], list[Term]], derived: float) -> Case:
        single, narrow, batched, called, differentiated = (
            self.source.random() < share for share in (0.12, 0.12, 0.35, 0.2, derived)
        )
        whole = not single and (narrow or self.source.random() < 0.08)
        if narrow or (whole and self.source.random() < 0.5):
            self.numbers, self.special = WHOLE, 0.4
        terms = tuple(grown())
        parameters = [name for name in self.leaves if name.startswith("p")]
        baked = tuple(name for name in parameters if self.source.random() < 0.5)
        for name in baked:
            self.leaves[name] = self.leaves[name] + 0.0  # programs have one zero among their constants
        exact = whole or narrow
        return Case(
            terms, self.leaves, baked, batched and not whole, single, differentiated and not exact, whole, narrow,
            called=called or whole, more=self.more(baked),
        )  # fmt: skip

    def extremes(self, hand: list[tuple[Plan, Shape]]) -> Case:
        """Single operations of leaves, at the ends of the range."""
        single = self.source.random() < 0.3
        self.numbers, self.special = (ENDS_SINGLE if single else ENDS), 1.0
        terms = tuple(self.planned(plan, shape, 0) for plan, shape in hand)
        return Case(
            terms, self.leaves, batched=self.source.random() < 0.4, single=single, extreme=True, more=self.more()
        )

    def more(self, baked: tuple[str, ...] = ()) -> tuple[dict[str, np.ndarray], ...]:
        """Other values of the leaves, but for those that are baked."""
        first, special = self.leaves, self.special
        self.special, found = max(special, OTHERS), []
        for _ in range(POINTS - 1):
            self.leaves = {}
            for name, wanted in self.wanted.items():
                self.leaves[name] = first[name] if name in baked else self.drawn(wanted)
            found.append(self.leaves)
        self.leaves, self.special = first, special
        return tuple(found)

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
        return self.planned(plan, shape, depth - 1)

    def planned(self, plan: Plan, shape: Shape, depth: int) -> Term:
        args: list[Term] = []
        for arg in plan.args:
            args.append(self.operand(arg, args, depth))
        return Term(plan.code, plan.numpy, tuple(args), shape, setup=plan.setup, rounding=plan.rounding)

    def operand(self, wanted: Operand, before: list[Term], depth: int) -> Term:
        if isinstance(wanted, Plan):
            return Term(wanted.code, wanted.numpy, tuple(before), wanted.shape, rounding=wanted.rounding)
        if isinstance(wanted, Graded):
            return self.leaf(wanted)
        return self.term(wanted, depth) if depth > 0 else self.leaf(wanted)

    def leaf(self, wanted: Shape | Graded) -> Term:
        shape = (wanted.n, wanted.n) if isinstance(wanted, Graded) else wanted
        kind = self.source.choice(KINDS)
        name = f"{kind[0].lower()}{len(self.leaves)}"
        self.wanted[name], self.leaves[name] = wanted, self.drawn(wanted)
        return Term(f'tx.{kind}("{name}", shape={shape})', np.asarray, (), shape, leaf=name)

    def drawn(self, wanted: Shape | Graded) -> np.ndarray:
        return wanted.matrix(self.source) if isinstance(wanted, Graded) else self.array(wanted)

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
        before = next(reversed(self.leaves.values()), np.zeros(0)).reshape(-1)
        if len(before) and self.source.random() < 0.4:  # operands that are equal, or opposite, here and there
            sign = self.source.choice((1.0, 1.0, -1.0))
            for k in range(size):
                if self.source.random() < 0.6:
                    entries[k] = sign * before[k % len(before)]
        return np.array(entries, float).reshape(shape)
