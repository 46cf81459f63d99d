"""The core in LLVM's intermediate language, compiled from C and optimised once by clang, for all processors and
platforms.

    python -m twistax.solver.text        write core.ll.xz again

At run time llvmlite only generates machine code from it. The clang is that of the package `ziglang`, in the version
that `VERSION` names: LLVM reads text of its own version and of older ones, so that of a newer clang might be refused.
"""

from __future__ import annotations

import lzma
import re
import subprocess
import sys
import tempfile
from pathlib import Path

from .sources import amalgamation, fingerprint

#: Of the package `ziglang`, whose clang is 20.1.2.
VERSION = "0.15.2"

_TEXT = Path(__file__).parent / "core.ll.xz"

#: No errno, no traps, no stack protector: they call functions of a C library that need not be there. `a b + c` may be
#: one instruction. The baseline of x86-64: no instruction of one processor gets into the text.
_FLAGS = (
    *("-std=c99", "-O2", "-g0", "-march=x86_64", "-ffp-contract=fast", "-fno-math-errno"),
    *("-fno-sanitize=undefined", "-fno-stack-protector", "-fomit-frame-pointer", "-fno-asynchronous-unwind-tables"),
    *("-S", "-emit-llvm"),
)

#: Attributes of functions that name a processor: with them LLVM would not use what the processor at hand has.
_ATTRIBUTES = re.compile(
    r' "(target-cpu|target-features|tune-cpu|stack-protector-buffer-size|min-legal-vector-width|frame-pointer'
    r'|no-trapping-math)"="[^"]*"'
)


def compiled_text() -> str:
    """A newly compiled text.

    Raises:
        FileNotFoundError, subprocess.CalledProcessError: `ziglang` is not installed, or refuses the sources.
    """
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder, "core.c"), Path(folder, "core.ll")
        source.write_text(amalgamation())
        subprocess.run([sys.executable, "-m", "ziglang", "cc", *_FLAGS, str(source), "-o", str(target)], check=True)
        text = target.read_text()
    text = _ATTRIBUTES.sub("", text)
    for group in re.findall(r"^attributes (#\d+) = \{ *\}$", text, flags=re.MULTILINE):  # LLVM refuses empty ones
        text = re.sub(rf"^attributes {group} = .*\n| {group}\b", "", text, flags=re.MULTILINE)
    text = re.sub(
        r"^(target (triple|datalayout)|source_filename|; ModuleID|!.*ident).*\n", "", text, flags=re.MULTILINE
    )
    return f"; core of sources {fingerprint()} by ziglang {VERSION}\n{text}"


def kept_text() -> str:
    """The text in the package."""
    return lzma.decompress(_TEXT.read_bytes()).decode()


if __name__ == "__main__":
    _TEXT.write_bytes(lzma.compress(compiled_text().encode(), preset=9 | lzma.PRESET_EXTREME))
    print(f"{_TEXT.name}: {_TEXT.stat().st_size / 1000:.0f} kB")
