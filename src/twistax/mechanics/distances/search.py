"""Searches for the nearest features of solids, as kernels."""

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
    return KernelFunction(function, Native() if installed() else XLA(), of_matrices=True, constant=True)
