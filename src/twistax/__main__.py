"""The command line: `python -m twistax demo`, `report`, `examples`, and `--version`, which lists what is installed."""

from __future__ import annotations

import argparse
import difflib
import importlib
import platform
import shutil
import sys
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import Any, NoReturn

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
    """An argument parser whose errors are one line with exit status 2. Options cannot be abbreviated."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options | {"allow_abbrev": False})

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {message} (see {self.prog} --help)\n")

    def refuse(self, unknown: Sequence[str]) -> NoReturn:
        """The error for unknown arguments, with the option that is closest to the first one."""
        near = difflib.get_close_matches(unknown[0], self._option_string_actions, 1)
        self.error(f"unrecognized arguments: {' '.join(unknown)}{f'; did you mean {near[0]}?' if near else ''}")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a sub-command; returns the exit status. Enables x64 for this process after the arguments are parsed."""
    parser = OneLineParser(
        prog="twistax",
        description="Dynamics of rigid bodies and mechanisms, written as expressions, compiled to JAX.",
        epilog="In Python: import twistax as tx. Documentation: docs/index.md; python docs/site builds it as a site.",
    )
    parser.add_argument("--version", action="store_true", help="versions of the packages and devices, for a bug report")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND")
    demo = commands.add_parser(
        "demo",
        help="simulate and draw a tumbling body, then optimise, check and draw the landing of a rocket",
        description="Optimises a powered descent with six degrees of freedom, checks it by integration, draws it.",
    )
    demo_options.add_options(demo)
    demo.set_defaults(module=".demo.landing", rerun="")
    report = commands.add_parser(
        "report",
        help="measure errors against run times, speed, stability and all figures of the documentation",
        description="Measures error against run time on scenes with exact solutions, for the methods of twistax and "
        "diffrax. --stability, --speed, --optimal, --figures and --gpu select other reports. Writes a page, figures, "
        "tables.",
    )
    report_options.add_options(report)
    report.set_defaults(module=".report.command", rerun="; repeat the command to resume")
    examples = commands.add_parser(
        "examples",
        help="copy the examples of the gallery to a folder",
        description="Copies the examples of the documentation, scripts with their data, to a folder.",
    )
    examples.add_argument("folder", type=Path, nargs="?", default=Path("examples"), help="the folder (./examples)")
    examples.add_argument("--out", type=Path, metavar="DIR", help="another way to name the folder")
    options, unknown = parser.parse_known_args(arguments)
    if unknown:
        commands.choices.get(options.command, parser).refuse(unknown)
    if options.version:
        print(versions())
        return 0
    if options.command == "examples":
        return copy_examples(options.out or options.folder)
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
    """Copy the scripts and their data; existing files are not overwritten. Returns the exit status."""
    package = Path(__file__).parent
    source = next(path for path in (package / "examples", package.parents[1] / "examples") if path.is_dir())
    files = sorted(path for path in source.iterdir() if path.is_file())
    there = [path.name for path in files if (folder / path.name).exists()]
    if there:
        print(f"twistax examples: {folder / there[0]} exists; name another folder", file=sys.stderr)
        return 2
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for path in files:
            shutil.copy(path, folder)
    except OSError as error:
        print(f"twistax examples: cannot write to {folder}: {error.strerror}", file=sys.stderr)
        return 2
    print(f"copied {len(files)} files to {folder}; run one there: cd {folder} && python free_body.py")
    return 0


def versions() -> str:
    """Versions of Python and of the required packages, JAX's devices, and the installed extras."""
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
