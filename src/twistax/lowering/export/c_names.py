"""Names of arrays in C."""

from __future__ import annotations

import re
from collections.abc import Sequence

from ...errors import InputError, ModelError
from .functions import Port

__all__ = ["checked_name", "comment", "identifiers"]

#: Headers of C99, which a header of that name would hide.
_STANDARD = frozenset(
    (
        *("assert", "complex", "ctype", "errno", "fenv", "float", "inttypes", "iso646", "limits", "locale", "math"),
        *("setjmp", "signal", "stdarg", "stdbool", "stddef", "stdint", "stdio", "stdlib", "string", "tgmath", "time"),
        *("wchar", "wctype"),
    )
)

#: Of the names of arrays, by kind.
_PREFIXES = {
    "x": "x_",
    "u": "u_",
    "p": "p_",
    "rate": "rate_",
    "output": "output_",
    "constraint": "constraint_",
    "jacobian": "by_",
}


def identifiers(ports: Sequence[Port]) -> dict[Port, str]:
    """What each array is called: a prefix of its kind, and its name, in which what C does not allow is an underscore.

    Letters beyond ASCII become their numbers: u03c9. Prefixes keep names apart from C's words and from libm's.

    Raises:
        ModelError: two arrays get one name.
    """
    found: dict[str, Port] = {}
    for port in ports:
        name = port.kind if port.kind == "t" else _PREFIXES[port.kind] + _plain(port.name)
        if name in found:
            raise ModelError(
                f"{found[name].name!r} and {port.name!r} would both be called {name} in C.\n  fix: rename one"
            )
        found[name] = port
    return {port: name for name, port in found.items()}


def checked_name(name: str) -> str:
    """A name of a user's, with which the names of files and functions begin.

    Raises:
        InputError: C does not allow it, or has a header of that name.
    """
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
        raise InputError(f"name expects a letter, then letters, digits and underscores, got {name!r}")
    if name.lower() in _STANDARD:
        raise InputError(f"name expects another one than {name!r}: {name.lower()}.h is a header of C itself")
    return name


def comment(text: str) -> str:
    """Text that may stand in a comment, whatever a user named things."""
    return re.sub(r"[^ -~]|[*/\\?]", "_", text)


def _plain(name: str) -> str:
    return "".join(c if re.fullmatch(r"[A-Za-z0-9_]", c) else "_" if ord(c) < 128 else f"u{ord(c):04x}" for c in name)
