"""Products, factorisations and solutions with matrices, as loops."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..code import NAMES, Code, NotNative
from .entrywise import EntryWriter, Lazy, Value, broadcast, number, viewed
from .memory import View, collapsed, steps

#: Sums of a product that are added up side by side: as many as hide how long one addition takes.
_SUMS = 8


class MatrixWriter(EntryWriter):
    """Loops over the entries of matrices."""

    # ---- products ------------------------------------------------------------------------------------------------

    def product(self, numbers: Any, a: Value, b: Value) -> Value:
        """As `jax.lax.dot_general`."""
        (left, right), (left_batch, right_batch) = numbers
        free = [
            [k for k in range(len(v.shape)) if k not in (*c, *d)]
            for v, c, d in ((a, left, left_batch), (b, right, right_batch))
        ]
        batch = tuple(a.shape[k] for k in left_batch)
        rows, columns = (tuple(v.shape[k] for k in f) for v, f in zip((a, b), free, strict=True))
        shape = (*batch, *rows, *columns)
        if math.prod(a.shape[k] for k in left) == 1:
            n, m = len(batch), len(batch) + len(rows)
            first = broadcast(_ordered(a, left_batch, free[0]), shape, range(m))
            second = broadcast(_ordered(b, right_batch, free[1]), shape, [*range(n), *range(m, len(shape))])
            return Lazy(
                lambda reader, x, y: np.asarray(reader.graph.mul(int(x), int(y))), (first, second), shape, a.dtype
            )
        if a.dtype.kind != "f":
            raise NotNative(f"products of matrices of {a.dtype} have no native form")
        A = self._grouped(self.stored(a), left_batch, free[0], left)
        B = self._grouped(self.stored(b), right_batch, free[1], right)
        # Entries side by side are those of the second factor.
        turned = B.shape[1] == 1 or (B.strides[1] != 1 and A.strides[1] == 1 and A.shape[1] > 1)
        A, B = (B, A) if turned else (A, B)
        C = self.buffer(a.dtype, (A.shape[0], A.shape[1], B.shape[1]))
        strides = (C.strides[0], C.strides[2], C.strides[1]) if turned else C.strides

        def one(index: str, _: list[str]) -> list[str]:
            self._product(*(self.within(v, index) for v in (A, B, C)))
            return []

        if all(C.shape):
            self.loop("0", str(A.shape[0]), one)
        groups = zip((batch, rows, columns), strides, strict=True)
        return C.of(shape, [step * stride for group, stride in groups for step in steps(group)])

    def _grouped(self, a: View, *groups: Sequence[int]) -> View:
        """The axes of each group as one; copied where they do not follow one another."""
        shapes = [[a.shape[k] for k in group] for group in groups]
        strides = [collapsed(s, [[a.strides[k] for k in g]])[1][0] for s, g in zip(shapes, groups, strict=True)]
        lengths = [math.prod(shape) for shape in shapes]
        if any(len(s) > 1 for s in strides):
            ordered = _ordered(a, *groups)
            return self.contiguous(ordered).of(lengths, steps(lengths))
        return a.of(lengths, [s[0] if s else 0 for s in strides])

    def _product(self, A: View, B: View, C: View) -> None:
        """C_ij = sum_k A_ik B_jk; entries of C follow one another along j."""
        (m, depth), n = A.shape, B.shape[0]
        if self.widest > 1 and m == 1 and A.strides[1] == B.strides[1] == 1 and depth > 1:
            self._inner_products(A, B, C)
            return
        if self.widest > 1 and B.strides[0] != 1 and n > 1:
            wide = self.buffer(B.dtype, (depth, n))
            B = B.of((depth, n), B.strides[::-1])
            self.assign(wide, B)
            B = wide.of((n, depth), wide.strides[::-1])
        width = self.width(n) if self.widest > 1 else 1
        high, across = _divided(m, _SUMS), 1
        if self.widest == 1:
            high, across = _divided(m, 4), _divided(n, 4 if self.code.module.processor.bits == 512 else 2)
        else:
            across = max(1, min(_SUMS // high, n // width))
        wide_code = self.code if width == 1 else self.code.of(width)
        kind = NAMES[A.dtype]
        zero = (wide_code.vector(kind), wide_code.constant(kind, 0.0))

        def block(row: str, column: str) -> None:
            rows = [self.at(A, self.plus(row, str(i))) for i in range(high)]
            columns = [self.at(B, self.plus(column, str(j * width))) for j in range(across)]

            def term(k: str, sums: list[str]) -> list[str]:
                left, right = self.times(k, A.strides[1]), self.times(k, B.strides[1])
                bs = [self.load(B, self.plus(c, right), width) for c in columns]
                new = []
                for i, r in enumerate(rows):
                    a = self.load(A, self.plus(r, left), width, 0)
                    new += [
                        wide_code.multiply_add(kind, a, b, s)
                        for b, s in zip(bs, sums[i * across : (i + 1) * across], strict=True)
                    ]
                return new

            sums = self.loop("0", str(depth), term, [zero] * (high * across))
            for i in range(high):
                for j in range(across):
                    entry = self.at(C, self.plus(row, str(i)), self.plus(column, str(j * width)))
                    self.store(C, entry, sums[i * across + j], width)

        self.blocks(m, high, lambda row: self.blocks(n, across * width, lambda column: block(row, column)))

    def _inner_products(self, a: View, B: View, C: View) -> None:
        """C_0j = sum_k a_0k B_jk, where entries along k follow one another."""
        n, depth = B.shape
        width, high, kind = self.width(depth), _divided(n, _SUMS), NAMES[a.dtype]
        code, vectors = self.code.of(width), depth // self.width(depth)
        zero = (code.vector(kind), code.constant(kind, 0.0))

        def block(row: str) -> None:
            rows = [self.at(B, self.plus(row, str(i))) for i in range(high)]

            def term(k: str, sums: list[str]) -> list[str]:
                place = self.times(k, width)
                x = self.load(a, place, width)
                ys = [self.load(B, self.plus(r, place), width) for r in rows]
                return [code.multiply_add(kind, x, y, s) for y, s in zip(ys, sums, strict=True)]

            sums = [self._sum(code, kind, s) for s in self.loop("0", str(vectors), term, [zero] * high)]

            def rest(k: str, sums: list[str]) -> list[str]:
                x = self.load(a, k)
                ys = [self.load(B, self.plus(r, k)) for r in rows]
                return [self.code.multiply_add(kind, x, y, s) for y, s in zip(ys, sums, strict=True)]

            sums = self.loop(str(vectors * width), str(depth), rest, [(kind, s) for s in sums])
            for i, s in enumerate(sums):
                self.store(C, self.at(C, "0", self.plus(row, str(i))), s)

        self.blocks(n, high, block)

    def _sum(self, code: Code, kind: str, vector: str) -> str:
        """The sum of the entries of a vector, in any order."""
        name, start = f"llvm.vector.reduce.fadd.{code.suffix(kind)}", code.of(1).constant(kind, -0.0)
        code.module.declarations.add(f"declare {kind} @{name}({kind}, {code.vector(kind)})")
        return code.emit(f"call reassoc {kind} @{name}({kind} {start}, {code.vector(kind)} {vector})")

    # ---- factors and solutions -----------------------------------------------------------------------------------

    def cholesky(self, a: Value) -> Value:
        """The lower factor of each matrix: column by column, what is left is reduced at once."""
        n = a.shape[-1]
        work, padded = self._work(a)
        column = self._zeros(a.dtype, padded)
        zero = self.code.constant(NAMES[a.dtype], 0.0)
        kind = NAMES[a.dtype]

        def one(A: View) -> None:
            def eliminate(k: str, _: list[str]) -> list[str]:
                root = self.code.intrinsic("sqrt", kind, self.load(A, self.at(A, k, k)))
                inverse = self.code.instruction("fdiv", kind, self.code.constant(kind, 1.0), root)
                self.store(A, self.at(A, k, k), root)
                self.store(column, k, zero)  # vectors reach back to places that are done
                following = self.plus(k, "1")

                def scale(i: str, _: list[str]) -> list[str]:
                    value = self.code.instruction("fmul", kind, self.load(A, self.at(A, i, k)), inverse)
                    self.store(A, self.at(A, i, k), value)
                    self.store(column, i, value)
                    return []

                def reduce(i: str, _: list[str]) -> list[str]:
                    self._subtract(A, i, column, self.load(column, i), following, self.plus(i, "1"))
                    return []

                self.loop(following, str(n), scale)
                self.loop(following, str(n), reduce)
                return []

            self.loop("0", str(n), eliminate)

        self._of_each(work, one)
        lower = np.tril(np.ones((n, n), bool))
        mask = broadcast(self.table(lower), a.shape, [len(a.shape) - 2, len(a.shape) - 1])

        def masked(reader: Any, m: Any, x: Any) -> Any:
            return np.asarray(reader.graph.select(int(m), int(x), reader.graph.zero))

        return Lazy(masked, (mask, work), a.shape, a.dtype)

    def lu(self, a: Value, index: np.dtype[Any]) -> list[Value]:
        """LU with partial pivoting: [L and U in one, the rows swapped with, the permutation]."""
        n, kind, batch = a.shape[-1], NAMES[a.dtype], a.shape[:-2]
        work, padded = self._work(a)
        above = self._zeros(a.dtype, padded)
        pivots, order = (self.buffer(index, (*batch, n)) for _ in range(2))
        self.assign(order, broadcast(self.table(np.arange(n, dtype=index)), order.shape, [len(batch)]))
        code, name = self.code, NAMES[index]

        def one(A: View, pivots: View, order: View) -> None:
            def eliminate(k: str, _: list[str]) -> list[str]:
                following = self.plus(k, "1")
                here = code.emit(f"trunc i64 {k} to {name}") if name == "i32" else k
                here = code.spread(name, here) if code.lanes > 1 else here

                def better(i: str, now: list[str]) -> list[str]:
                    size = code.intrinsic("fabs", kind, self.load(A, self.at(A, i, k)))
                    more = code.instruction("fcmp ogt", kind, size, now[0])
                    row = code.emit(f"trunc i64 {i} to {name}") if name == "i32" else i
                    row = code.spread(name, row) if code.lanes > 1 else row
                    return [code.select(kind, more, size, now[0]), code.select(name, more, row, now[1])]

                size = code.intrinsic("fabs", kind, self.load(A, self.at(A, k, k)))
                start = [(code.vector(kind), size), (code.vector(name), here)]
                chosen = self.loop(following, str(n), better, start)[1]
                self.store(pivots, k, chosen)
                chosen_rows = [self._wide(name, row) for row in self.lanes_of(name, chosen)]
                self._swap(order, [k] * code.lanes, chosen_rows)
                self.loop(
                    "0",
                    str(n),
                    lambda j, _: self._swap(self._column(A, j), [k] * code.lanes, chosen_rows, A.strides[0]),
                )
                inverse = code.instruction("fdiv", kind, code.constant(kind, 1.0), self.load(A, self.at(A, k, k)))
                self.store(above, k, code.constant(kind, 0.0))  # vectors reach back to places that are done

                def copy(j: str, _: list[str]) -> list[str]:
                    self.store(above, j, self.load(A, self.at(A, k, j)))
                    return []

                self.loop(following, str(n), copy)

                def reduce(i: str, _: list[str]) -> list[str]:
                    factor = code.instruction("fmul", kind, self.load(A, self.at(A, i, k)), inverse)
                    self._subtract(A, i, above, factor, following, str(n))
                    self.store(A, self.at(A, i, k), factor)
                    return []

                self.loop(following, str(n), reduce)
                return []

            self.loop("0", str(n), eliminate)

        self._of_each(work, one, pivots, order)
        return [work, pivots, order]

    def triangular_solve(self, p: Mapping[str, Any], a: Value, b: Value) -> Value:
        """X with T X = B, and with X T = B."""
        last = len(a.shape) - 1
        stored: Value = self.stored(a)
        lower = p["lower"]
        turn = [*range(last - 1), last, last - 1]
        if not p["left_side"]:
            stored, b, lower = _ordered(stored, turn), _ordered(b, turn), not lower
        if p["transpose_a"]:
            stored, lower = _ordered(stored, turn), not lower
        A = self.stored(stored)
        n, columns, kind = A.shape[-1], b.shape[-1], NAMES[a.dtype]
        X, _ = self._work(b)

        def one(X: View, A: View) -> None:
            def solve(step: str, _: list[str]) -> list[str]:
                k = step if lower else self._reflected(step, n)
                if not p["unit_diagonal"]:
                    one = self.code.constant(kind, 1.0)
                    inverse = self.code.instruction("fdiv", kind, one, self.load(A, self.at(A, k, k)))
                    self._scale(X, k, inverse, columns)
                row = self.within(X, k)

                def reduce(i: str, _: list[str]) -> list[str]:
                    self._subtract(X, i, row, self.load(A, self.at(A, i, k)), "0", str(columns))
                    return []

                first, stop = (self.plus(k, "1"), str(n)) if lower else ("0", k)
                self.loop(first, stop, reduce)
                return []

            self.loop("0", str(n), solve)

        self._of_each(X, one, A)
        return X if p["left_side"] else _ordered(X, turn)

    def _work(self, a: Value) -> tuple[View, int]:
        """A copy of matrices whose rows have room for whole vectors."""
        shape = (*a.shape[:-1], -(-a.shape[-1] // self.widest) * self.widest)
        work = self.buffer(a.dtype, shape)
        if shape != a.shape:
            self.assign(work, number(0.0, a.dtype, shape))
        work = work.of(a.shape, work.strides)
        self.assign(work, a)
        return work, shape[-1]

    def _zeros(self, dtype: np.dtype[Any], length: int) -> View:
        row = self.buffer(dtype, (length,))
        self.assign(row, number(0.0, dtype, (length,)))
        return row

    def _of_each(self, first: View, work: Any, *more: View) -> None:
        """Call a function of matrices for each place of their first axes."""
        depth = len(first.shape) - 2

        def level(arrays: list[View], axes: int) -> None:
            if axes == 0:
                work(*arrays)
                return

            def step(index: str, _: list[str]) -> list[str]:
                level([self.within(a, index) for a in arrays], axes - 1)
                return []

            self.loop("0", str(arrays[0].shape[0]), step)

        level([first, *more], depth)

    def _subtract(self, A: View, i: str, row: View, factor: str, first: str, stop: str) -> None:
        """A_ij -= factor row_j for j from `first` to `stop` - 1, or for whole vectors around them."""
        width, kind = self.widest, NAMES[A.dtype]
        code = self.code if width == 1 else self.code.of(width)
        wide = factor if width == 1 else code.spread(kind, factor)
        wide = code.instruction("fneg", kind, wide)
        start = self.at(A, i)

        def block(index: str, _: list[str]) -> list[str]:
            j = self.times(index, width)
            there = self.plus(start, j)
            new = code.multiply_add(kind, wide, self.load(row, j, width), self.load(A, there, width))
            self.store(A, there, new, width)
            return []

        self.loop(self._whole(first, 0), self._whole(stop, width - 1), block)

    def _scale(self, X: View, k: str, factor: str, columns: int) -> None:
        """Row k times a factor."""
        width, kind = self.widest, NAMES[X.dtype]
        code = self.code if width == 1 else self.code.of(width)
        wide, start = factor if width == 1 else code.spread(kind, factor), self.at(X, k)

        def block(index: str, _: list[str]) -> list[str]:
            there = self.plus(start, self.times(index, width))
            self.store(X, there, code.instruction("fmul", kind, self.load(X, there, width), wide), width)
            return []

        self.loop("0", self._whole(str(columns), width - 1), block)

    def _whole(self, place: str, more: int) -> str:
        """The vector that a place is in, and `more` places later."""
        if place.isdigit():
            return str((int(place) + more) // self.widest)
        return self.code.emit(f"udiv i64 {self.plus(place, str(more))}, {self.widest}")

    def _reflected(self, step: str, n: int) -> str:
        return str(n - 1 - int(step)) if step.isdigit() else self.code.emit(f"sub i64 {n - 1}, {step}")

    def _column(self, A: View, j: str) -> View:
        return self.within(A.of(A.shape[::-1], A.strides[::-1]), j)

    def _wide(self, name: str, value: str) -> str:
        return self.code.emit(f"sext i32 {value} to i64") if name == "i32" else value

    def _swap(self, a: View, here: Sequence[str], there: Sequence[str], stride: int = 1) -> list[str]:
        """Change the places of two entries, of each member other ones."""
        first, second = (self.member(a, [self.times(place, stride) for place in places]) for places in (here, there))
        for one, other in zip(first, second, strict=True):
            x, y = (self.code.emit(f"load {a.stored}, ptr {place}, align {a.dtype.itemsize}") for place in (one, other))
            self.code.lines.append(f"store {a.stored} {y}, ptr {one}, align {a.dtype.itemsize}")
            self.code.lines.append(f"store {a.stored} {x}, ptr {other}, align {a.dtype.itemsize}")
        return []


def _ordered(value: Value, *groups: Sequence[int]) -> Value:
    """An array with its axes in another order."""
    order = [axis for group in groups for axis in group]
    shape = tuple(value.shape[k] for k in order)
    return viewed(value, lambda v: v.of([v.shape[k] for k in order], [v.strides[k] for k in order]), shape)


def _divided(length: int, most: int) -> int:
    """The height of equal blocks of at most `most` places, of which the last one may reach back."""
    return -(-length // -(-length // most))
