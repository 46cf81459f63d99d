"""mpmath, where a report needs more digits than a float has."""

from __future__ import annotations

from types import ModuleType

__all__ = ["mpmath"]


def mpmath() -> ModuleType:
    """The module.

    Raises:
        ImportError: it is not installed; says what to do.
    """
    try:
        import mpmath
    except ImportError as error:
        raise ImportError("this report needs mpmath, which is not installed; fix: pip install mpmath") from error
    return mpmath
