"""Runs the sections successively, each in a separate process, so that a failure does not affect the others."""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

#: Seconds that all sections may take.
_BUDGET = 320.0
#: Of the process of a section: the folder for its rows, and the section.
_CHILD = "import sys; from twistax.report.gpu.command import measure; measure(*sys.argv[1:])"
#: What all rows are appended to.
_ROWS = "gpu.jsonl"


def run(arguments: argparse.Namespace) -> int:
    """Measure; rows are printed and written as they are measured. Returns 0, or 1 if a section failed."""
    from .sections import SECTIONS

    folder: Path = arguments.out
    folder.mkdir(parents=True, exist_ok=True)
    (folder / _ROWS).unlink(missing_ok=True)
    begin, failed = time.perf_counter(), []
    with tempfile.TemporaryDirectory() as cache:
        for name, section in SECTIONS.items():
            left = _BUDGET - (time.perf_counter() - begin)
            lap = time.perf_counter()
            print(f"== {name}", flush=True)
            ended = "not measured: the time is over"
            if left > 10.0:
                ended = _child(name, folder, cache, min(section.seconds, left))
            print(f"== {name}: {ended}, {time.perf_counter() - lap:.1f} s", flush=True)
            if ended != "done":
                failed.append(name)
    print(f"== {time.perf_counter() - begin:.1f} s in all; not done: {', '.join(failed) or 'none'}", flush=True)
    return 1 if failed else 0


def _child(name: str, folder: Path, cache: str, seconds: float) -> str:
    """How the process of a section ended."""
    from .sections import SECTIONS

    # Without what other processes compiled, twistax or the driver.
    environment = {**os.environ, "TWISTAX_CACHE": cache, "CUDA_CACHE_PATH": str(Path(cache, "driver"))}
    environment["XLA_PYTHON_CLIENT_PREALLOCATE"] = "false"
    environment.update(SECTIONS[name].environment)
    process = subprocess.Popen([sys.executable, "-u", "-c", _CHILD, str(folder), name], env=environment)
    try:
        code = process.wait(seconds)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
        return "stopped"
    return "done" if code == 0 else f"ended with {code}"


def measure(folder: str, name: str) -> None:
    """A section, in this process."""
    import jax

    jax.config.update("jax_enable_x64", True)
    from ...scalar.targets.llvm.backend import TARGETS
    from .sections import SECTIONS

    if not TARGETS["cuda"].present:
        print("  not measured: JAX has no CUDA device here", flush=True)
        return
    with (Path(folder) / _ROWS).open("a") as file:
        for row in SECTIONS[name].rows():
            file.write(json.dumps({"section": name, **dataclasses.asdict(row)}) + "\n")
            file.flush()
            print(f"  {row.what:<58} {row.by:<26} {row.value:.4g} {row.unit}".rstrip(), flush=True)
