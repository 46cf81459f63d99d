"""The options of `python -m twistax report`."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable
from pathlib import Path

from ...scenes import SCENES
from ..speed.case import CASES
from .contenders import CONTENDERS

__all__ = ["add_options"]


def add_options(parser: argparse.ArgumentParser) -> None:
    """The options of `twistax report`."""
    parser.add_argument(
        "--scene",
        type=_one_of("scene", SCENES),
        action="append",
        metavar="NAME",
        help=f"only this scene; may be given again. There are {', '.join(SCENES)}",
    )
    parser.add_argument(
        "--method",
        type=_one_of("method", CONTENDERS),
        action="append",
        metavar="NAME",
        help=f"only this method; may be given again. There are {', '.join(CONTENDERS)}",
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help="under two minutes: few methods, coarse settings, few repeats; the longest scenes only if asked for",
    )
    parser.add_argument(
        "--stability",
        action="store_true",
        help="another report: what happens at the edges, stiff, long, extreme or wrong; --scene and --method do not "
        "apply, and --quick leaves out what takes long",
    )
    parser.add_argument(
        "--speed",
        action="store_true",
        help="another report: what one evaluation of dynamics costs, ours and others'; --case picks functions",
    )
    parser.add_argument(
        "--case",
        type=_one_of("case", CASES),
        action="append",
        metavar="NAME",
        help=f"with --speed, only this function; may be given again. There are {', '.join(CASES)}",
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        default=Path("out/report"),
        help="folder for page, figures and tables (./out/report); what was measured there before is kept",
    )
    parser.add_argument("--no-progress", action="store_true", help="no progress bar")


def _one_of(what: str, names: Iterable[str]) -> Callable[[str], str]:
    known = list(names)

    def read(text: str) -> str:
        if text not in known:
            raise argparse.ArgumentTypeError(f"there is no {what} {text!r}; there are {', '.join(known)}")
        return text

    return read
