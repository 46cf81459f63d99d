"""The command line: `python -m twistax demo` and `python -m twistax report`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from .demo import arguments as demo_arguments
from .demo.arguments import OneLineParser
from .report import arguments as report_arguments


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a sub-command; returns the exit status. Switches x64 on for this process once the arguments are read."""
    parser = OneLineParser(prog="twistax", description="Rigid-body dynamics as expressions, compiled to JAX.")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    demo = commands.add_parser(
        "demo",
        help="land a rocket: compile, check, solve, simulate, draw",
        description="A 6-DoF powered descent, found by the embedded optimiser, simulated again by two integrators.",
    )
    demo_arguments.add_options(demo)
    demo.set_defaults(run=_demo, rerun="")
    report = commands.add_parser(
        "report",
        help="what is measured: error against run time, the edges, speed, every other figure",
        description="Error against run time: scenes with known answers, by our methods and by diffrax. With "
        "--stability, --speed or --figures something else. Writes a page, figures and tables.",
    )
    report_arguments.add_options(report)
    report.set_defaults(run=_report, rerun="; the same command goes on where it stopped")
    given = parser.parse_args(arguments)

    import jax

    jax.config.update("jax_enable_x64", True)
    try:
        return int(given.run(given))
    except KeyboardInterrupt:
        print(f"\ntwistax {given.command}: interrupted{given.rerun}", file=sys.stderr)
        return 130


# Loaded when they are run: both import diffrax.
def _demo(given: argparse.Namespace) -> int:
    from .demo.command import run

    return run(given)


def _report(given: argparse.Namespace) -> int:
    from .report.command import run

    return run(given)


if __name__ == "__main__":
    sys.exit(main())
