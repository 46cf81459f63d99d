"""A bad use of the package, and what is made of it: an error of ours that names the thing and what came, or not."""

import contextlib
import importlib
import io
import re
import time
import traceback
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import twistax as tx

#: What a message says of what was expected, or of how to mend it.
MENDS = re.compile(
    r"fix:|expect|must|need|give|known|has:|are:|takes?\b|choose from|--help|reads|requires|knows|too many|missing a"
    r"|\bpass\b|accepts"
)
#: What a ShapeError says.
SHAPES = re.compile(r"^(\S+ expects [^\n]* with shape|'\w+': \w+ expects shape) \([^\n]*\), got \(")
#: Seconds of this process that an error may take.
SLOWEST = 2.0


class Bad(NamedTuple):
    """A bad use: a few words for it, the call, and what its error must say, or be."""

    name: str
    call: Callable[[], Any]
    words: tuple[str | type, ...]


def bad(name: str, call: Callable[[], Any], *words: str | type) -> Bad:
    """A row of a table. The words: the thing's name first, then what came, and its class where that matters."""
    return Bad(name, call, words)


class Verdict(NamedTuple):
    """What a bad use ended in."""

    kind: str  # "ours", "foreign", "silent", "words", "slow"
    text: str


def judge(row: Bad) -> Verdict:
    """Run a bad use."""
    said = io.StringIO()
    begin, kind = time.process_time(), None
    try:
        with contextlib.redirect_stderr(said):
            found = row.call()
    except tx.TwistaxError as error:
        kind, text = type(error), str(error)
        clean = error.__cause__ is None and (error.__context__ is None or error.__suppress_context__)
    except SystemExit as error:  # argparse, which has printed why
        text, clean = said.getvalue(), error.code == 2
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        return Verdict("foreign", f"{type(error).__name__}: {str(error)[:300]} [{place.filename}:{place.lineno}]")
    else:
        return Verdict("silent", f"gave {str(found)[:200]}")
    seconds = time.process_time() - begin
    if not clean:
        return Verdict("foreign", f"chained: {text}")
    words = (*row.words, tx.ShapeError) if SHAPES.search(text) else row.words
    missing = [word for word in words if (word not in text if isinstance(word, str) else word is not kind)]
    if missing or not row.words or not MENDS.search(text):
        return Verdict("words", f"missing {missing or 'what to do'}: {text}")
    return Verdict("slow" if seconds > SLOWEST else "ours", text if seconds <= SLOWEST else f"{seconds:.1f} s: {text}")


AREAS = (
    "language",
    "systems",
    "integration",
    "lie_maps",
    "mechanisms",
    "flights",
    "optimisation",
    "pictures",
    "commands",
)


def tables() -> dict[str, list[Bad]]:
    """All rows, by area."""
    return {area: importlib.import_module(area).ROWS for area in AREAS}


def rows() -> Iterator[tuple[str, Bad]]:
    """All rows with their areas."""
    for area, own in tables().items():
        for row in own:
            yield area, row
