"""Where rows come from: versions, code, machine, effort."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import platform
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

import jax

import twistax

__all__ = ["ABSENT", "KERNELS", "Origin", "machine", "origin_of"]

#: What native kernels need, and what stands for the version of a package that is not installed.
KERNELS, ABSENT = "llvmlite", "absent"
_VERSIONED = ("twistax", "jax", "jaxlib", "diffrax", "equinox", "numpy", KERNELS)


@dataclasses.dataclass(frozen=True)
class Origin:
    """Rows of different origins do not belong together.

    Attributes:
        versions: of the packages in use.
        code: digest of this package's own code; the demo, and what only writes pages, left out.
        machine: processor, cores, Python, JAX and its flags.
        effort: what was run, and how often it was repeated.
    """

    versions: dict[str, str]
    code: str
    machine: str
    effort: dict[str, Any]

    @property
    def digest(self) -> str:
        """A short word that differs where anything does."""
        return _digest(json.dumps(dataclasses.asdict(self), sort_keys=True).encode())


def origin_of(effort: Mapping[str, Any], versions: Mapping[str, str] | None = None) -> Origin:
    """Of rows measured now.

    Args:
        effort: plain values.
        versions: of other packages in use.
    """
    return Origin({name: _version(name) for name in _VERSIONED} | dict(versions or {}), _code(), machine(), {**effort})


def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return ABSENT


def _code() -> str:
    root = Path(twistax.__file__).parent
    files = [path for path in root.rglob("*") if path.suffix in (".py", ".c") and path.stem not in ("page", "words")]
    silent = (root / "demo", root / "report" / "pages")
    return _digest(b"".join(path.read_bytes() for path in sorted(files) if not any(s in path.parents for s in silent)))


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:12]


def machine() -> str:
    """Processor, cores, Python, JAX and its flags in one line."""
    model = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        lines = [line.split(":", 1) for line in info.read_text().splitlines() if line.startswith("model name")]
        model = lines[0][1].strip() if lines else model
    return (
        f"{model}, {os.cpu_count()} cores, Python {platform.python_version()}, JAX {jax.__version__} on "
        f"{jax.devices()[0].platform}, XLA_FLAGS {os.environ.get('XLA_FLAGS', 'none')}"
    )
