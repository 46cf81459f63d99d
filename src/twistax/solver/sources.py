"""The C sources of the core as one file, for compilation and for exported controllers."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

_FOLDER = Path(__file__).parent / "c"

#: In the order in which they are joined; each needs those before it only through `work.h` and `qp_work.h`.
_FILES = (
    "options",
    "dense",
    "symmetric",
    "workspace",
    "evaluate",
    "equalities",
    "riccati",
    "sweep",
    "measures",
    "direction",
    "start",
    "filter",
    "line_search",
    "restoration",
    "optimum",
    "solve",
    "linearised",
    "kernels",
    "lanes",
    "integrate",
    "nodes",
    "transcription",
    "members",
    "handler",
    "cholesky",
    "qp_scale",
    "qp_measure",
    "qp_newton",
    "qp_active",
    "qp_interior",
    "qp_proof",
    "qp",
    "squares",
    "squares_handler",
)

_INCLUDE = re.compile(r'^#include "(?P<name>\w+\.\w+)"\n', re.MULTILINE)

#: What real.h says of single precision and of double.
_OF_PRECISION = re.compile(r"^#ifdef TWX_SINGLE\n(?P<single>.*?)^#else\n(?P<double>.*?)^#endif\n", re.M | re.S)


def header() -> str:
    """The interface in C: structures, statuses and functions, with the options expanded."""
    after = ("transcription.h", "members.h", "qp.h", "squares.h")
    return "".join([_expanded(_read("core.h")), *(_expanded(_read(name), drop=("core.h", *after)) for name in after)])


def amalgamation() -> str:
    """All of the core as one C99 file; only the functions of the header have external linkage."""
    parts = ["#define TWX_INTERNAL static\n", header()]
    inner = ("dense.h", "work.h", "phase.h", "qp_work.h", "ffi.h")
    parts += [_INCLUDE.sub("", _read(name)) for name in inner]
    parts += [_expanded(_read(f"{name}.c"), drop=("core.h", "members.h", "squares.h", *inner)) for name in _FILES]
    return "\n".join(parts)


#: What an exported controller does without: names of options, batches, and the dense program.
_IN_PYTHON = ("options", "members", "handler", "cholesky", "squares", "squares_handler")


def controller_core(single: bool, **sizes: int) -> str:
    """The part of the core that solves transcribed problems, as one C99 file whose only external names begin with
    `twx_`.

    Args:
        single: whether it computes in single precision.
        sizes: constants of the file, so that loops over them are unrolled: `states`, `controls` and `parameters` of an
            interval, `inequalities` and `equalities` of all, `stages` of the method.
    """
    inner = ("dense.h", "work.h", "phase.h")
    drop = ("core.h", *inner)
    parts = [f"#define TWX_{name.upper()} {size}\n" for name, size in sizes.items()]
    # Inline, so that a function which is not called is no warning.
    parts += [
        "#define TWX_INTERNAL static inline\n",
        _OF_PRECISION.sub(r"\g<single>" if single else r"\g<double>", _expanded(_read("core.h"))),
        _expanded(_read("transcription.h"), drop),
    ]
    parts += [_INCLUDE.sub("", _read(name)) for name in inner]
    kept = [name for name in _FILES if name not in _IN_PYTHON and not name.startswith("qp")]
    return "\n".join([*parts, *(_expanded(_read(f"{name}.c"), drop) for name in kept)])


def squares_core() -> str:
    """The part of the core that solves dense constrained least-squares problems, as one C99 file."""
    inner = ("dense.h", "qp_work.h")
    headers = ["qp.h", "squares.h"]
    # Inline, so that a function which is not called is no warning.
    parts = ["#define TWX_INTERNAL static inline\n", _read("real.h")]
    parts += [_expanded(_read(name), (*inner, *headers)) for name in headers]
    parts += [_INCLUDE.sub("", _read(name)) for name in inner]
    kept = [name for name in _FILES if name in ("dense", "cholesky", "squares") or name.startswith("qp")]
    return "\n".join([*parts, *(_expanded(_read(f"{name}.c"), (*inner, *headers)) for name in kept)])


def fingerprint() -> str:
    """A checksum of the amalgamation, which the compiled text contains."""
    return hashlib.sha256(amalgamation().encode()).hexdigest()


def options(file: str) -> list[tuple[str, float, str]]:
    """Name, default and source of every option of a `.def` file, in the order of the C structure."""
    entry = re.compile(r'^OPTION\((?P<name>\w+), (?P<value>[^,]+), "(?P<source>[^"]+)"\)$', re.MULTILINE)
    return [(m["name"], float(m["value"]), m["source"]) for m in entry.finditer(_read(file))]


def constant(file: str, name: str) -> int:
    """A whole number that a header defines."""
    defined = re.search(rf"^#define {name} (\d+)", _read(file), re.MULTILINE)
    assert defined is not None, name
    return int(defined[1])


def _read(name: str) -> str:
    return (_FOLDER / name).read_text()


def _expanded(text: str, drop: tuple[str, ...] = ()) -> str:
    return _INCLUDE.sub(lambda m: "" if m["name"] in drop else _read(m["name"]), text)
