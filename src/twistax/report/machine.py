"""What a figure was measured on."""

from __future__ import annotations

import os
import platform
from pathlib import Path

import jax

__all__ = ["machine"]


def machine() -> str:
    """Processor, cores, Python, JAX and its flags in one line."""
    model = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        named = [
            line.split(":", 1)[1].strip() for line in info.read_text().splitlines() if line.startswith("model name")
        ]
        model = named[0] if named else model
    flags = os.environ.get("XLA_FLAGS", "none")
    device = jax.devices()[0].platform
    return (
        f"{model}, {os.cpu_count()} cores, Python {platform.python_version()}, JAX {jax.__version__} on {device}, "
        f"XLA_FLAGS {flags}"
    )
