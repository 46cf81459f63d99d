"""Numbers of XML files."""

import time
from pathlib import Path

import pytest

import twistax as tx
from twistax.mechanics.models.xml_file import read_xml

SMALL = Path(__file__).parents[1] / "mechanics" / "models" / "small.dml"


def test_many_digits_are_refused_at_once() -> None:
    element = read_xml(SMALL, document_type=True)
    start = time.process_time()
    with pytest.raises(tx.ModelError, match="expected a finite number, got '1111"):
        element.read("1" * 10_000 + "x")
    assert time.process_time() - start < 0.2
