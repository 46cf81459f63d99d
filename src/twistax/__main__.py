"""The command line: `python -m twistax demo`, `report`, `examples`, and what is installed, `--version`."""

from __future__ import annotations

import argparse
import importlib
import platform
import shutil
import sys
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import NoReturn

from .demo import options as demo_options
from .progress import Progress
from .report import arguments as report_options

#: What of the extras a report of a bug should name.
EXTRAS = {
    "native": ("llvmlite",),
    "plot": ("matplotlib",),
    "models": ("mujoco",),
    "casadi": ("casadi",),
    "control": ("control",),
    "tables": ("pandas",),
    "report": ("matplotlib", "jinja2"),
    "docs": ("sphinx", "myst-parser", "furo"),
    "view": ("viser",),
    "video": ("imageio-ffmpeg",),
    "fmu": ("fmpy",),
    "cuda": ("jax-cuda12-plugin",),
}


class OneLineParser(argparse.ArgumentParser):
    """A parser whose errors are one line and exit status 2."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {message} (see {self.prog} --help)\n")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a sub-command; returns the exit status. Switches x64 on for this process once the arguments are read."""
    parser = OneLineParser(
        prog="twistax",
        description="Dynamics of rigid bodies and mechanisms, written as expressions, compiled to JAX.",
        epilog="In Python: import twistax as tx. Pages to read: docs/index.md, or as a site: python docs/site.",
    )
    parser.add_argument("--version", action="store_true", help="versions of all that takes part, for a report of a bug")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND")
    demo = commands.add_parser(
        "demo",
        help="land a rocket: compile, check, solve, simulate, draw",
        description="A 6-DoF powered descent, found by the embedded optimiser, simulated again by two integrators.",
    )
    demo_options.add_options(demo)
    demo.set_defaults(module=".demo.landing", rerun="")
    report = commands.add_parser(
        "report",
        help="what is measured: error against run time, the edges, speed, every other figure",
        description="Error against run time: scenes with known answers, by our methods and by diffrax. With "
        "--stability, --speed, --optimal or --figures something else. Writes a page, figures and tables.",
    )
    report_options.add_options(report)
    report.set_defaults(module=".report.command", rerun="; the same command goes on where it stopped")
    examples = commands.add_parser(
        "examples",
        help="copy the examples of the gallery to a folder",
        description="Copies the examples of the documentation, scripts that run by themselves, to a folder.",
    )
    examples.add_argument("--out", type=Path, metavar="DIR", default=Path("examples"), help="the folder (./examples)")
    options = parser.parse_args(arguments)
    if options.version:
        print(versions())
        return 0
    if options.command == "examples":
        return copy_examples(options.out)
    if options.command is None:
        parser.print_help()
        return 0

    import jax

    jax.config.update("jax_enable_x64", True)
    try:
        # Loaded when it is run: both import diffrax.
        with Progress("load"):
            command = importlib.import_module(options.module, __package__)
        return int(command.run(options))
    except KeyboardInterrupt:
        print(f"\ntwistax {options.command}: interrupted{options.rerun}", file=sys.stderr)
        return 130


def copy_examples(folder: Path) -> int:
    """Copy the scripts and their data; files that are there stay. Returns the exit status."""
    package = Path(__file__).parent
    source = next(path for path in (package / "examples", package.parents[1] / "examples") if path.is_dir())
    files = sorted(path for path in source.iterdir() if path.is_file())
    there = [path.name for path in files if (folder / path.name).exists()]
    if there:
        print(f"twistax examples: {folder / there[0]} is there; name another folder with --out", file=sys.stderr)
        return 2
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for path in files:
            shutil.copy(path, folder)
    except OSError as error:
        print(f"twistax examples: cannot write to {folder}: {error.strerror}", file=sys.stderr)
        return 2
    first = folder / "free_body.py"
    print(f"{len(files)} files in {folder}; they draw their figures into the working directory: python {first}")
    return 0


def versions() -> str:
    """Python, the packages that twistax stands on, JAX's devices, and the extras that are there."""
    import jax

    from . import __version__

    def of(names: Sequence[str]) -> str:
        return ", ".join(f"{name} {_installed(name) or 'missing'}" for name in names)

    devices = jax.devices()
    lines = [
        f"twistax {__version__}",
        f"Python {platform.python_version()} on {platform.system()}, {platform.machine()}",
        of(("jax", "jaxlib", "numpy", "scipy", "diffrax", "equinox", "jaxtyping")),
        f"backend {jax.default_backend()}, {len(devices)} x {devices[0].device_kind}, x64 "
        f"{'on' if jax.numpy.ones(()).dtype.itemsize == 8 else 'off'}",
    ]
    there = [f"extra {name}: {of(packages)}" for name, packages in EXTRAS.items() if all(map(_installed, packages))]
    lacking = [name for name in EXTRAS if not all(map(_installed, EXTRAS[name]))]
    return "\n".join([*lines, *there, *([f"extras not installed: {', '.join(lacking)}"] if lacking else [])])


def _installed(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


if __name__ == "__main__":
    sys.exit(main())
