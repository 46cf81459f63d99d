"""What is known before a program runs, where integrators look for it."""

from ..lowering.concrete import is_finite, is_traced

__all__ = ["is_finite", "is_traced"]
