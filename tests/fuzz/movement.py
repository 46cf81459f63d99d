"""Joins, indices of all kinds, and maps over an axis."""

from random import Random

import numpy as np
from matrices import products
from plans import Plan, maker
from term import Shape


@maker
def joined(source: Random, shape: Shape) -> Plan | None:
    if not shape:
        return None
    if len(shape) == 1:
        n = shape[0]
        if n == 1:
            return Plan("tx.Concat({0})", np.atleast_1d, ((),))
        k = source.randint(1, n - 1)
        found = [
            Plan("tx.Concat({0}, {1})", lambda a, b: np.concatenate([a, b]), ((k,), (n - k,))),
            Plan("np.concatenate([{0}, {1}])", lambda a, b: np.concatenate([a, b]), ((k,), (n - k,))),
            Plan("tx.Hstack({0}, {1})", lambda a, b: np.hstack([a, b]), ((k,), (n - k,))),
            Plan(f"tx.Concat({{0}}, {{1}})[{k}:]", lambda a, b: np.concatenate([a, b])[k:], ((k,), (n,))),
        ]
        if n <= 6:
            fields = ", ".join(f"{{{i}}}" for i in range(n))
            found.append(Plan(f"tx.Stack({fields})", lambda *a: np.stack(a), ((),) * n))
            found.append(Plan(f"tx.Concat({fields})", lambda *a: np.stack(a), ((),) * n))
        return source.choice(found)
    fields = ", ".join(f"{{{i}}}" for i in range(shape[0]))
    found = [
        Plan(f"tx.Stack({fields})", lambda *a: np.stack(a), (shape[1:],) * shape[0]),
        Plan(f"np.stack([{fields}])", lambda *a: np.stack(a), (shape[1:],) * shape[0]),
    ]
    if len(shape) == 2 and shape[1] > 1:
        k = source.randint(1, shape[1] - 1)
        halves = ((shape[0], k), (shape[0], shape[1] - k))
        found.append(Plan("tx.Hstack({0}, {1})", lambda a, b: np.hstack([a, b]), halves))
        found.append(Plan("tx.Block([[{0}, {1}]])", lambda a, b: np.block([[a, b]]), halves))
        found.append(Plan("np.block([[{0}, {1}]])", lambda a, b: np.block([[a, b]]), halves))
    if len(shape) == 2 and shape[0] > 1:
        k = source.randint(1, shape[0] - 1)
        found.append(
            Plan("tx.Vstack({0}, {1})", lambda a, b: np.vstack([a, b]), ((k, shape[1]), (shape[0] - k, shape[1])))
        )
    return source.choice(found)


def _index(source: Random, n: int) -> tuple[str, str]:
    """Code of an index of one axis, and whether it is basic ("b") or a list ("a")."""
    k = source.randint(-n, n - 1)
    lo, hi = sorted((source.randint(0, n - 1), source.randint(0, n - 1)))
    several = [source.randint(-n, n - 1) for _ in range(source.randint(1, 3))]
    mask = [source.random() < 0.6 for _ in range(n)]
    mask[source.randrange(n)] = True
    return source.choice(
        [
            (str(k), "b"), (":", "b"), (f"{lo}:{hi + 1}", "b"), ("::-1", "b"), (f"{lo}::2", "b"), ("-1:", "b"),
            (str(several), "a"), (f"np.array({several})", "a"), (str(mask), "a"), (f"np.array({mask})", "a"),
        ]
    )  # fmt: skip


@maker
def index(source: Random, shape: Shape) -> Plan | None:
    """Of all kinds, mixed. The operand's shape is drawn, and indices until one gives the wanted shape."""
    for _ in range(30):
        whole = source.choice([(3,), (4,), (2, 3), (3, 3), (3, 4), (2, 2, 3), (3, 2, 4), (2, 1, 3)])
        count = source.randint(1, len(whole))
        parts = [_index(source, n)[0] for n in whole[:count]]
        if source.random() < 0.15:
            parts.insert(source.randint(0, count), "None")
        if source.random() < 0.15:
            parts.append("...")
        text = ", ".join(parts)
        try:
            found = eval(f"a[{text}]", {"a": np.zeros(whole), "np": np})
        except IndexError:
            continue
        if found.shape == shape:
            code = compile(f"a[{text}]", "index", "eval")
            return Plan(f"{{0}}[{text}]", lambda a, code=code: eval(code, {"a": a, "np": np}), (whole,))
    return None


@maker
def index_of_a_join(source: Random, shape: Shape) -> Plan | None:
    """What rewrites look into."""
    for _ in range(10):
        rows = source.choice([(2, 2), (3,), (2, 3)])
        found = [_index(source, n)[0] for n in (2, *rows)[: source.randint(1, 1 + len(rows))]]
        if source.random() < 0.4:  # a number, a slice and a list: NumPy puts the list's axis first
            last = str([0, source.randint(-2, 1)])
            found = [str(source.randint(-2, 1)), *[":"] * (len(rows) - 1), last]
        parts = ", ".join(found)
        try:
            entries = eval(f"a[{parts}]", {"a": np.zeros((2, *rows)), "np": np})
        except IndexError:
            continue
        if entries.shape == shape:
            code = compile(f"a[{parts}]", "index", "eval")
            return Plan(
                f"tx.Stack({{0}}, {{1}})[{parts}]",
                lambda a, b, code=code: eval(code, {"a": np.stack([a, b]), "np": np}),
                (rows, rows),
            )
    return None


@maker
def batch(source: Random, shape: Shape) -> Plan | None:
    if not shape:
        return None
    n = source.choice([2, 3])
    found = [products("tx.Vmap(lambda row: row * row + {1}, batch={0})", lambda a, b: a * a + b, shape, ())]
    if len(shape) == 1:
        m = shape[0]
        found += [
            Plan("tx.Vmap(lambda row: tx.linalg.Sum(row), batch={0})", lambda a: a.sum(axis=-1), ((*shape, n),)),
            products("tx.Vmap(lambda c: c @ {1}, batch={0}, axis=1)", lambda a, b: a.T @ b, (n, m), (n,)),
            Plan("tx.Vmap(lambda c: c[0] - c[1], batch={0}, axis=1)", lambda a: a[0] - a[1], ((max(m, 2), m),)),
            products("tx.Vmap(lambda a, b: a @ b, batch=[{0}, {1}])", lambda a, b: np.sum(a * b, 1), *2 * [(m, n)]),
            Plan("tx.Vmap(lambda a: tx.Linterp(a, [-1, 0.5, 3], [2.0, -1, 0.5]), batch={0})",
                 lambda a: np.interp(a, [-1, 0.5, 3], [2, -1, 0.5]), (shape,)),
        ]  # fmt: skip
    if len(shape) == 2:
        m, k = shape
        found += [
            Plan("tx.Vmap(lambda a: tx.Vmap(lambda b: a - 2.0 * b, batch={1}), batch={0})",
                 lambda a, b: a[:, None] - 2.0 * b[None], ((m,), (k,))),
            Plan("tx.Vmap(lambda c: c * {1}, batch={0}, axis=1)", lambda a, b: a.T * b, ((k, m), (k,))),
        ]  # fmt: skip
    return source.choice(found)
