"""The options of the demo, and the syntax of a start on the command line."""

import argparse
import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..scenes.powered_descent import Start

_EXAMPLE = "height=900,offset=400:150,velocity=-60:-20:-100,tilt=60"
_INITIAL = f"""the initial state, for example {_EXAMPLE}
items are NAME=VALUE, separated by commas; numbers of a vector by colons; omitted items keep their defaults
  height    m above the pad (900)
  offset    m from the pad, x:y (400:150)
  velocity  m/s in world axes, x:y:z, z up (-60:-20:-100)
  tilt      degrees from upright, 0 to 180 (60)
  axis      world axis of the tilt, x:y:z (-0.2:-1:0)
  righting  degrees per second about that axis, towards upright (4.6)"""
_SEED = """start the solve from a perturbed guess: at every node, position +- 40 m, attitude +- 0.2 rad,
velocity +- 20 m/s, angular velocity +- 0.12 rad/s, mass +- 1200 kg, thrust +- 120 kN, independent for
each entry, and the flight time +- 2 s (standard deviations); the same seed gives the same guess"""


def add_options(parser: argparse.ArgumentParser) -> None:
    """The options of `twistax demo`."""
    parser.formatter_class = argparse.RawTextHelpFormatter
    options = {
        "--initial": (parse_start, "START", None, _INITIAL),
        "--guess-seed": (_integer(0, 2**32 - 1), "N", None, _SEED),
        "--nodes": (_integer(5, 200), "N", 25, "nodes of the first mesh, 5 to 200 (25)"),
        "--max-iterations": (_integer(1, 10**6), "N", 400, "the largest number of iterations (400)"),
        "--out": (Path, "DIR", Path("out"), "folder for figures, animations and the table (./out)"),
    }
    for name, (read, metavar, default, text) in options.items():
        parser.add_argument(name, type=read, metavar=metavar, default=default, help=text)


def _integer(low: int, high: int) -> Callable[[str], int]:
    def read(text: str) -> int:
        if not (text.strip().lstrip("+-").isdecimal() and low <= int(text) <= high):
            raise argparse.ArgumentTypeError(f"expects a whole number from {low} to {high}, got {text!r}")
        return int(text)

    return read


#: Items of a start: field, count of numbers, unit, what is demanded of them.
_ITEMS: dict[str, tuple[str, int, float, str, Callable[..., bool]]] = {
    "height": ("height", 1, 1.0, "be above zero", lambda height: height > 0.0),
    "offset": ("offset", 2, 1.0, "", lambda *_: True),
    "velocity": ("velocity", 3, 1.0, "", lambda *_: True),
    "tilt": ("tilt", 1, math.pi / 180.0, "be from 0 to 180 degrees", lambda angle: 0.0 <= angle <= 180.0),
    "axis": ("tilt_axis", 3, 1.0, "not be zero", lambda *axis: math.hypot(*axis) >= 1e-6),
    "righting": ("righting", 1, math.pi / 180.0, "", lambda *_: True),
}


def parse_start(text: str) -> "Start":
    """A start from `height=900,offset=400:150,...`; omitted items have their defaults.

    Raises:
        argparse.ArgumentTypeError: a sentence that describes the error.
    """
    # Only the demo reads its start: the other commands and --help do not load the package.
    from ..scenes.powered_descent import Start

    fields: dict[str, Any] = {}
    for part in text.split(","):
        name, equals, value = (piece.strip() for piece in part.partition("="))
        if not equals or name not in _ITEMS:
            known = ", ".join(_ITEMS)
            raise argparse.ArgumentTypeError(
                f"{part.strip()!r} is not one of {known} with a value; write e.g. {_EXAMPLE}"
            )
        field, count, unit, demand, holds = _ITEMS[name]
        if field in fields:
            raise argparse.ArgumentTypeError(f"{name} occurs twice")
        numbers = _numbers(name, value, count)
        if not holds(*numbers):
            raise argparse.ArgumentTypeError(f"{name} must {demand}, got {value}")
        fields[field] = tuple(unit * number for number in numbers) if count > 1 else unit * numbers[0]
    return Start(**fields)


def _numbers(name: str, text: str, count: int) -> tuple[float, ...]:
    try:
        numbers = tuple(float(part) for part in text.split(":"))
    except ValueError:
        numbers = ()
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        wanted = "a number" if count == 1 else f"{count} numbers separated by colons"
        raise argparse.ArgumentTypeError(f"{name} expects {wanted}, got {text!r}")
    if max(map(abs, numbers)) > 1e6:
        raise argparse.ArgumentTypeError(f"{name} is too large: no entry may exceed 1e6, got {text!r}")
    return numbers
