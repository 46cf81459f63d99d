"""What rows depend on besides scene, method and setting: versions, code, machine and how they were measured."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Iterable, Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

import twistax

from .. import turns
from ..machine import machine

__all__ = ["ABSENT", "KERNELS", "Origin", "origin_of"]

#: How the report of flights measures.
_FLYING = tuple(
    Path(__file__).with_name(f"{name}.py") for name in ("own", "rivals", "contenders", "flights", "command")
)
#: What native kernels need, and what stands for its version where it is not there.
KERNELS, ABSENT = "llvmlite", "absent"
_VERSIONED = ("twistax", "jax", "jaxlib", "diffrax", "equinox", "numpy")


@dataclasses.dataclass(frozen=True)
class Origin:
    """Where rows come from. Rows of different origins do not belong together.

    Attributes:
        versions: of the packages in use.
        code: digest of this package's own code, what only prints or draws left out.
        machine: processor, cores, Python, JAX and its flags.
        effort: how flights were repeated.
    """

    versions: dict[str, str]
    code: str
    machine: str
    effort: dict[str, Any]

    @property
    def digest(self) -> str:
        """A short word that differs where anything does."""
        return _digest(json.dumps(dataclasses.asdict(self), sort_keys=True).encode())


def origin_of(effort: Any, measuring: Iterable[Path] = _FLYING, others: Mapping[str, str] | None = None) -> Origin:
    """Of rows measured now.

    Args:
        effort: a dataclass of plain values.
        measuring: files of the report that may change an error or a time.
        others: versions of other packages in use.
    """
    versions = {name: metadata.version(name) for name in _VERSIONED} | {KERNELS: _kernels()} | dict(others or {})
    return Origin(versions, _code(measuring), machine(), dataclasses.asdict(effort))


def _kernels() -> str:
    try:
        return metadata.version(KERNELS)
    except metadata.PackageNotFoundError:
        return ABSENT


def _code(measuring: Iterable[Path]) -> str:
    """Of all that may change an error or a time: not the reports and the demo, but how this report measures."""
    root = Path(twistax.__file__).parent
    files = [path for path in root.rglob("*.py") if path.relative_to(root).parts[0] not in ("report", "demo")]
    files += [Path(turns.__file__), *measuring]
    return _digest(b"".join(path.read_bytes() for path in sorted(files)))


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:12]
