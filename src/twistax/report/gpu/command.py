"""Runs the sections one after the other, each in a process of its own: one that fails takes nothing else with it."""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path

#: Seconds that all sections may take.
_BUDGET = 420.0
#: Of the process of a section: the folder for its rows, and the section.
_CHILD = "import sys; from twistax.report.gpu.command import measure; measure(*sys.argv[1:])"


def run(arguments: argparse.Namespace) -> int:
    """Measure; rows are printed and written as they come. Returns 0, or 1 where a section failed."""
    from .sections import SECTIONS

    folder: Path = arguments.out
    folder.mkdir(parents=True, exist_ok=True)
    begin, failed = time.perf_counter(), []
    for name, (_, most) in SECTIONS.items():
        left = _BUDGET - (time.perf_counter() - begin)
        if left < 10.0:
            print(f"== {name}: not measured, {_BUDGET:.0f} s are over", flush=True)
            continue
        lap = time.perf_counter()
        print(f"== {name}", flush=True)
        ended = _child(name, folder, min(most, left))
        print(f"== {name}: {ended} after {time.perf_counter() - lap:.1f} s", flush=True)
        if ended != "done":
            failed.append(name)
    print(f"== {time.perf_counter() - begin:.1f} s in all; failed: {', '.join(failed) or 'none'}", flush=True)
    return 1 if failed else 0


def _child(name: str, folder: Path, seconds: float) -> str:
    """How the process of a section ended; what it prints goes to a file and to the output."""
    environment = {
        **os.environ,
        "XLA_PYTHON_CLIENT_PREALLOCATE": "false",
        "TWISTAX_CACHE": str(folder.resolve() / "cache"),
    }
    if name == "without":
        environment["JAX_PLATFORMS"] = "cpu"
    with (folder / f"{name}.txt").open("w") as file:
        process = subprocess.Popen(
            [sys.executable, "-c", _CHILD, str(folder), name],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            env=environment,
            text=True,
        )
        try:
            # A reader of its own would be needed to stop in the middle of a silence: the file has what came until then.
            out, _ = process.communicate(timeout=seconds)
            ended = "done" if process.returncode == 0 else f"exit {process.returncode}"
        except subprocess.TimeoutExpired:
            process.kill()
            out, _ = process.communicate()
            ended = "stopped"
        file.write(out)
        print(out, end="", flush=True)
    return ended


def measure(folder: str, name: str) -> None:
    """A section, in this process."""
    import jax

    jax.config.update("jax_enable_x64", True)
    from .sections import SECTIONS

    rows, _ = SECTIONS[name]
    with (Path(folder) / f"{name}.jsonl").open("w") as file:
        for row in rows():
            file.write(json.dumps(row._asdict()) + "\n")
            file.flush()
            print(f"  {row.what:<58} {row.by:<26} {row.value:.4g} {row.unit}".rstrip(), flush=True)
