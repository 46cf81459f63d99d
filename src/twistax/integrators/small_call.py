"""Small calls, where integrators look for them."""

from ..lowering.small_call import fits, small_call

__all__ = ["fits", "small_call"]
