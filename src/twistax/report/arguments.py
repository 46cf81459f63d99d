"""The options of `python -m twistax report`. Names are looked up only if one is passed, because that loads the
package.
"""

from __future__ import annotations

import argparse
import difflib
import importlib
from collections.abc import Callable
from pathlib import Path

from ..progress import watching


def add_options(parser: argparse.ArgumentParser) -> None:
    """The options of `twistax report`."""
    kinds = parser.add_mutually_exclusive_group()
    for name, text in {
        "stability": "report on extreme cases: stiff systems, long runs, extreme values, invalid input",
        "speed": "report on the run time of one evaluation of dynamics, compared with other packages",
        "figures": "report with all other figures of docs/measured.md",
        "optimal": "report on trajectory problems with published optima, compared with IPOPT and Fatrop",
        "gpu": "report on kernels on a CUDA device, compared with XLA and the CPU; prints text",
    }.items():
        kinds.add_argument(f"--{name}", action="store_true", help=text)
    parser.add_argument(
        "--foreign", action="store_true", help="with --optimal: published problems, compared with plain IPOPT in CasADi"
    )
    quick = "minutes in place of an hour: few methods or functions, coarse settings, few repeats, no slow row; "
    parser.add_argument("--quick", action="store_true", help=f"{quick}the longest scenes only by --scene")
    for name, module, names, text in (
        ("scene", "..scenes", "SCENES", "only this scene"),
        ("method", ".work_precision.integrators", "INTEGRATORS", "only this method"),
        ("case", ".speed.cases", "CASES", "with --speed, only this function"),
        (
            "only",
            ".registry",
            "EVERY",
            "with --stability, --figures or --optimal, only this section, with --foreign this problem",
        ),
    ):
        several = f"{text}; may be repeated. An unknown name lists the available ones"
        known = _one_of("section" if name == "only" else name, module, names)
        parser.add_argument(f"--{name}", type=known, action="append", metavar="NAME", help=several)
    out = "folder for page, figures and tables (./out/report); measured values in it are reused"
    parser.add_argument("--out", type=Path, metavar="DIR", default=Path("out/report"), help=out)
    parser.add_argument("--again", action="store_true", help="measure all values again")
    tables = "insert the tables into this Markdown file, between the lines that name them"
    parser.add_argument("--renew", type=_file, metavar="FILE", help=tables)
    parser.add_argument("--no-progress", action="store_true", help="no progress bar")


def _one_of(what: str, module: str, names: str) -> Callable[[str], str]:
    @watching("load")
    def name(text: str) -> str:
        if text not in (known := list(getattr(importlib.import_module(module, __package__), names))):
            near = "".join(f"; did you mean {name}?" for name in difflib.get_close_matches(text, known, 1))
            raise argparse.ArgumentTypeError(f"there is no {what} {text!r}{near or '; there are ' + ', '.join(known)}")
        return text

    return name


def _file(text: str) -> Path:
    if not Path(text).is_file():
        raise argparse.ArgumentTypeError(f"there is no file {text!r}")
    return Path(text)
