"""Distances as kernels: searches for the nearest features, and the formulas for these."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from ...scalar.backends import XLA
from ...scalar.kernel_function import KernelFunction
from ...scalar.targets.llvm.backend import Native
from ...scalar.targets.llvm.machine_code import installed

R = TypeVar("R")


def search(function: Callable[..., R]) -> Callable[..., R]:
    """A function of arrays as a kernel without derivatives: its results count as constants.

    It is pure; `while` loops in it end for all arguments.
    """
    return KernelFunction(function, _backend(), of_matrices=True, constant=True)


def formula(function: Callable[..., R]) -> Callable[..., R]:
    """A pure function of small arrays as a kernel, with kernels for its derivatives; it may contain searches."""
    return KernelFunction(function, _backend())


def _backend() -> Native | XLA:
    return Native() if installed() else XLA()
