"""The command line: `python -m twistax demo`."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from .demo.arguments import OneLineParser, add_options

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a sub-command; returns the exit status. Switches x64 on for this process once the arguments are read."""
    parser = OneLineParser(prog="twistax", description="Rigid-body dynamics as expressions, compiled to JAX.")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    demo = commands.add_parser(
        "demo",
        help="land a rocket: compile, check, solve, fly again, draw",
        description="A 6-DoF powered descent, found by the embedded optimiser, flown again by two integrators.",
    )
    add_options(demo)
    given = parser.parse_args(arguments)

    import jax

    jax.config.update("jax_enable_x64", True)
    from .demo.command import run

    try:
        return run(given)
    except KeyboardInterrupt:
        print("\ntwistax demo: interrupted", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
