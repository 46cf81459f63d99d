"""Numbers as DAVE-ML writes them."""

from __future__ import annotations

import math
import re

import numpy as np

from ....checks import short
from ..xml_file import Element

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")


def number_of(element: Element, text: str, what: str = "a finite number") -> float:
    """The number in a text of an element. Raises ModelError with element and line."""
    word = text.strip()
    if not (_NUMBER.fullmatch(word) and math.isfinite(float(word))):
        raise element.wrong(f"expected {what}, got {short(word)}")
    return float(word)


def optional_number(element: Element, attribute: str) -> float | None:
    """An attribute as a number; None if it is not there."""
    if attribute not in element.attributes:
        return None
    return number_of(element, element.attributes[attribute], f"a finite number in {attribute}")


def limits_of(element: Element, least: str, most: str) -> tuple[float | None, float | None]:
    """Two attributes that limit a value, None for one that is absent. Raises ModelError where the first is higher."""
    lower, upper = optional_number(element, least), optional_number(element, most)
    if lower is not None and upper is not None and lower > upper:
        raise element.wrong(f"{least} {lower:g} is above {most} {upper:g}")
    return lower, upper


def numbers_of(element: Element) -> np.ndarray:
    """The numbers in an element, apart by commas or white space."""
    words = element.content.replace(",", " ").split()
    return np.array([number_of(element, word, "finite numbers") for word in words])
