"""Where arrays lie while a function of them runs, and views of them."""

from __future__ import annotations

import dataclasses
import weakref
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..code import NAMES, NotNative

#: Arrays begin at multiples of so many bytes.
ALIGNED = 64


class Space:
    """Places in one block of memory, which are taken again when nothing needs them.

    Attributes:
        size: bytes of the block so far.
    """

    def __init__(self) -> None:
        self.size = 0
        self._free: list[tuple[int, int]] = []  # first byte, bytes

    def view(self, like: NDArray[Any]) -> View:
        """A new array, laid out as one that is dense. Its place is free when no view of it is left."""
        size = -(-max(like.nbytes, 1) // ALIGNED) * ALIGNED
        start = self._taken(size)
        place = _Place()
        weakref.finalize(place, self._free.append, (start, size)).atexit = False
        return View("%arena", address(like) - start, like, place)

    def _taken(self, size: int) -> int:
        fitting = [own for own in self._free if own[1] >= size]
        if not fitting:
            self.size += size
            return self.size - size
        best = min(fitting, key=lambda own: own[1])
        self._free.remove(best)
        if best[1] > size:
            self._free.append((best[0] + size, best[1] - size))
        return best[0]


class _Place:
    """Taken as long as it lives."""


@dataclasses.dataclass(frozen=True, eq=False)
class View:
    """An array in memory, or one whose numbers are known.

    Its shape and strides are those of an array of NumPy's: what moves numbers without touching them moves that.

    Attributes:
        base: LLVM's name of a pointer; None: the numbers are known, they are those of `array`.
        origin: the address in NumPy's memory that stands for where the pointer points.
        array: its layout; its numbers mean something only where they are known.
        place: what keeps the memory from being used again.
    """

    base: str | None
    origin: int
    array: NDArray[Any]
    place: Any = None

    @property
    def shape(self) -> tuple[int, ...]:
        return self.array.shape

    @property
    def dtype(self) -> np.dtype[Any]:
        return self.array.dtype

    @property
    def known(self) -> bool:
        return self.base is None

    @property
    def number(self) -> Any:
        """The number that all entries are known to be; None: they are not."""
        if not self.known or not self.array.size:
            return None
        first = self.array.flat[0]
        # The bits count: a zero has a sign.
        same = not any(self.array.strides) or self.array.tobytes() == self.array.size * first.tobytes()
        return first if same else None

    @property
    def offset(self) -> int:
        """Bytes from where the pointer points to the first entry."""
        return address(self.array) - self.origin

    def seen(self, array: NDArray[Any]) -> View:
        """Another view of the same memory.

        Raises:
            RuntimeError: NumPy made a copy, whose addresses mean nothing.
        """
        if not self.known and array.size and not np.may_share_memory(array, self.array):
            raise RuntimeError(f"a view of {self.shape} became a copy of {np.shape(array)}")
        return dataclasses.replace(self, array=array)

    def part(self, index: Iterable[Any]) -> View:
        """Slices of axes: a view also where there are none, of which NumPy makes a number."""
        whole: Any = (*index, ...)
        return self.seen(self.array[whole])

    def moved(self, base: str | None, bytes: int = 0) -> View:
        """The same so many bytes on, or from another pointer on."""
        return dataclasses.replace(self, base=base or self.base, origin=self.origin - bytes)


def known(numbers: Any) -> View:
    """A view of numbers."""
    return View(None, 0, checked(np.asarray(numbers)))


def checked(array: NDArray[Any]) -> NDArray[Any]:
    """An array whose type machine code has.

    Raises:
        NotNative: it has not.
    """
    if array.dtype not in NAMES:
        raise NotNative(f"{array.dtype} has no native form")
    return array


def native_type(variable: Any) -> np.dtype[Any]:
    """The type of a variable of a jaxpr.

    Raises:
        NotNative: machine code has no such type, as of random keys.
    """
    dtype = getattr(variable.aval, "dtype", None)
    if not isinstance(dtype, np.dtype) or dtype not in NAMES:
        raise NotNative(f"{dtype} has no native form")
    return dtype


def address(array: NDArray[Any]) -> int:
    """Of the first entry, in NumPy's memory."""
    found: int = array.__array_interface__["data"][0]
    return found


def dense(shape: Sequence[int], dtype: Any, like: NDArray[Any] | None = None) -> NDArray[Any]:
    """The layout of a new array; its axes in the order in which they lie in the memory of another, if one is given."""
    if like is None:
        return checked(np.empty(shape, dtype))
    order = sorted(range(len(shape)), key=lambda d: -abs(like.strides[d]))
    if any(like.strides[d] == 0 and shape[d] > 1 for d in order):
        return checked(np.empty(shape, dtype))
    own = checked(np.empty([shape[d] for d in order], dtype))
    return own.transpose(np.argsort(order).tolist())
