"""The page of the stability report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ..work_precision.blocks import Block, Bullets, Details, Figure, Heading, Paragraph, Table
from .outcome import Outcome
from .row import Section

__all__ = ["TITLE", "page"]

#: Tables longer than this are folded up, unless something is wrong.
_SHOWN = 14

TITLE = "At the edges: what holds, what ends, and how it says so"


def page(
    outcomes: Sequence[Outcome], figures: Mapping[str, bytes], machine: str, versions: str, command: str
) -> list[Block]:
    """All blocks.

    Args:
        figures: SVG by the name of a section; empty without matplotlib.
        command: how to get this page again.
    """
    sections = list(dict.fromkeys(each.section for each in outcomes))
    bad = [each for each in outcomes if not each.good]
    not_run = sum(each.verdict == "not run" for each in outcomes)
    silent = [each for each in outcomes if each.found.failure is None and each.found.number != each.found.number]
    said = f"All {len(outcomes) - not_run} rows did what they should."
    if bad:
        said = f"**{len(bad)} of {len(outcomes)} rows did not do what they should**; they are marked."
    return [
        Heading(1, TITLE),
        Paragraph(
            "Each row takes one case to an edge and says what came: an error, a drift, or the name of the failure; "
            "what should come; and why, in a sentence. Every row is a test of the suite as well. "
            f"{said} {'No flight' if not silent else f'{len(silent)} flights'} ended with a number that is none and "
            "did not say so."
            + (f" {not_run} rows were not run: they need mpmath, `pip install mpmath`." if not_run else "")
        ),
        *(block for section in sections for block in _section(section, outcomes, figures.get(section.name))),
        *([] if figures else [Paragraph("No figures: they need matplotlib, `pip install 'twistax[plot]'`.")]),
        Heading(2, "How it was run"),
        Bullets(
            [
                f"Machine: {machine}. Double precision but for the section on single precision.",
                f"Versions: {versions}.",
                f"Run again: `{command}`. All rows are in `stability.csv`.",
                "`ends:` names a `tx.Result` and when; an error is its first line. Errors of attitudes are angles in "
                "rad, of the rest distances over their size, or over 1 where that is larger (`Scene.error`).",
            ]
        ),
    ]


def _section(section: Section, outcomes: Sequence[Outcome], figure: bytes | None) -> list[Block]:
    rows = [
        [
            _cell(each.row.case),
            each.row.method,
            _cell(each.found.text),
            _cell(each.row.expected.text),
            each.verdict,
            _cell(each.row.why),
        ]
        for each in outcomes
        if each.section is section
    ]
    drawn = [Figure(f"figures/stability-{section.name}.svg", figure, section.title)] if figure else []
    table = Table(["case", "by", "what came", "what should come", "", "why"], rows, words=6)
    bad = sum(not each.good for each in outcomes if each.section is section)
    summary = f"{len(rows)} rows, {f'{bad} of them UNEXPECTED' if bad else 'all as expected'}"
    folded = len(rows) > _SHOWN and not bad
    return [
        Heading(2, section.title),
        Paragraph(section.about),
        *drawn,
        *([Details(summary, [table])] if folded else [table]),
    ]


def _cell(text: str) -> str:
    """Text for a cell of a Markdown table."""
    return text.replace("|", "\\|")
