"""The options of `python -m twistax report`. Names are looked up only when one is given: that loads the package."""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Callable
from pathlib import Path

from ..progress import watching


def add_options(parser: argparse.ArgumentParser) -> None:
    """The options of `twistax report`."""
    kinds = parser.add_mutually_exclusive_group()
    for name, text in {
        "stability": "another report: what happens at the edges, stiff, long, extreme or wrong",
        "speed": "another report: what one evaluation of dynamics costs, ours and others'",
        "figures": "another report: every other figure of docs/measured.md",
        "optimal": "another report: trajectory problems with published optima, beside IPOPT and Fatrop",
        "gpu": "another report: kernels on a CUDA device beside XLA there and beside the CPU; rows as text",
    }.items():
        kinds.add_argument(f"--{name}", action="store_true", help=text)
    parser.add_argument(
        "--foreign", action="store_true", help="with --optimal: problems of others, stated beside plain IPOPT in CasADi"
    )
    quick = (
        "minutes rather than an hour: few methods or functions, coarse settings, few repeats, nothing that takes long; "
    )
    parser.add_argument("--quick", action="store_true", help=f"{quick}the longest scenes only if asked for")
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
        several = f"{text}; may be given again. A name that is not known is answered with those there are"
        known = _one_of("section" if name == "only" else name, module, names)
        parser.add_argument(f"--{name}", type=known, action="append", metavar="NAME", help=several)
    out = "folder for page, figures and tables (./out/report); what was measured there before is kept"
    parser.add_argument("--out", type=Path, metavar="DIR", default=Path("out/report"), help=out)
    parser.add_argument("--again", action="store_true", help="measure again what was measured there before")
    tables = "put the tables of bars into this Markdown file, between the lines that name them"
    parser.add_argument("--renew", type=_file, metavar="FILE", help=tables)
    parser.add_argument("--no-progress", action="store_true", help="no progress bar")


def _one_of(what: str, module: str, names: str) -> Callable[[str], str]:
    @watching("load")
    def name(text: str) -> str:
        if text not in (known := list(getattr(importlib.import_module(module, __package__), names))):
            raise argparse.ArgumentTypeError(f"there is no {what} {text!r}; there are {', '.join(known)}")
        return text

    return name


def _file(text: str) -> Path:
    if not Path(text).is_file():
        raise argparse.ArgumentTypeError(f"there is no file {text!r}")
    return Path(text)
