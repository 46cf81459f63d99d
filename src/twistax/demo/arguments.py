"""The options of the demo, and how a start is written on the command line."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

from ..scenes.powered_descent import Start

__all__ = ["OneLineParser", "add_options", "parse_start"]

_EXAMPLE = "height=900,offset=400:150,velocity=-60:-20:-100,tilt=60"

_INITIAL = f"""where the descent begins, for example {_EXAMPLE}
items are NAME=VALUE, separated by commas; numbers of a vector by colons; what is left out keeps its default
  height    m above the pad (900)
  offset    m from the pad, x:y (400:150)
  velocity  m/s in world axes, x:y:z, z up (-60:-20:-100)
  tilt      degrees from upright, 0 to 180 (60)
  axis      world axis it is tilted about, x:y:z (-0.2:-1:0)
  righting  degrees a second about that axis, back towards upright (4.6)"""

_SEED = """start the search from a perturbed guess: at every node, position +- 40 m, attitude +- 0.2 rad,
velocity +- 20 m/s, angular velocity +- 0.12 rad/s, mass +- 1200 kg, thrust +- 120 kN, each entry drawn
by itself, and the flight time +- 2 s (one standard deviation each); the same seed gives the same guess"""


class OneLineParser(argparse.ArgumentParser):
    """A parser whose errors are one line and exit status 2."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {message} (see {self.prog} --help)\n")


def add_options(parser: argparse.ArgumentParser) -> None:
    """The options of `twistax demo`."""
    parser.formatter_class = argparse.RawTextHelpFormatter
    options = {
        "--initial": (parse_start, "START", Start(), _INITIAL),
        "--guess-seed": (_whole(0, 2**32 - 1), "N", None, _SEED),
        "--nodes": (_whole(5, 200), "N", 25, "nodes of the search, 5 to 200 (25)"),
        "--max-iterations": (_whole(1, 10**6), "N", 400, "iterations after which the search gives up (400)"),
        "--out": (Path, "DIR", Path("out"), "folder for figure and table (./out)"),
    }
    for name, (read, metavar, default, text) in options.items():
        parser.add_argument(name, type=read, metavar=metavar, default=default, help=text)


def parse_start(text: str) -> Start:
    """A start from `height=900,offset=400:150,...`; what is left out keeps its default.

    Raises:
        argparse.ArgumentTypeError: a sentence about what is wrong.
    """
    readers: dict[str, tuple[str, Callable[[str], Any]]] = {
        "height": ("height", lambda value: _positive(_numbers("height", value, 1)[0])),
        "offset": ("offset", lambda value: _numbers("offset", value, 2)),
        "velocity": ("velocity", lambda value: _numbers("velocity", value, 3)),
        "tilt": ("tilt", lambda value: math.radians(_tilt(_numbers("tilt", value, 1)[0]))),
        "axis": ("tilt_axis", lambda value: _axis(_numbers("axis", value, 3))),
        "righting": ("righting", lambda value: math.radians(_numbers("righting", value, 1)[0])),
    }
    found: dict[str, Any] = {}
    for item in text.split(","):
        name, equals, value = (part.strip() for part in item.partition("="))
        if not equals or name not in readers:
            raise _wrong(f"{item.strip()!r} is not one of {', '.join(readers)} with a value; write e.g. {_EXAMPLE}")
        field, read = readers[name]
        if field in found:
            raise _wrong(f"{name} is given twice")
        found[field] = read(value)
    return Start(**found)


def _numbers(name: str, text: str, count: int) -> tuple[float, ...]:
    try:
        numbers = tuple(float(part) for part in text.split(":"))
    except ValueError:
        numbers = ()
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        wanted = "a number" if count == 1 else f"{count} numbers separated by colons"
        raise _wrong(f"{name} expects {wanted}, got {text!r}")
    if max(map(abs, numbers)) > 1e6:
        raise _wrong(f"{name} is beyond this world: no entry may exceed 1e6, got {text!r}")
    return numbers


def _positive(height: float) -> float:
    if height <= 0.0:
        raise _wrong(f"height must be above zero, got {height:g}")
    return height


def _tilt(angle: float) -> float:
    if not 0.0 <= angle <= 180.0:
        raise _wrong(f"tilt must be from 0 to 180 degrees, got {angle:g}")
    return angle


def _axis(axis: tuple[float, ...]) -> tuple[float, ...]:
    if math.hypot(*axis) < 1e-6:
        raise _wrong("axis must not be zero")
    return axis


def _wrong(sentence: str) -> argparse.ArgumentTypeError:
    return argparse.ArgumentTypeError(sentence)


def _whole(low: int, high: int) -> Callable[[str], int]:
    def read(text: str) -> int:
        try:
            number = int(text)
        except ValueError:
            number = low - 1
        if not low <= number <= high:
            raise _wrong(f"expects a whole number from {low} to {high}, got {text!r}")
        return number

    return read
