"""The table of errors of one line: each can still be made, and the tests that it names are there."""

import functools

import pytest

from mutations import MUTATIONS, ROOT, Mutation


@functools.cache
def text(file: str) -> str:
    return (ROOT / file).read_text()


@pytest.mark.parametrize("file", sorted({mutation.file for mutation in MUTATIONS}))
def test_errors_can_still_be_made(file: str) -> None:
    source = text(f"src/twistax/{file}")
    for mutation in MUTATIONS:
        if mutation.file == file:
            assert mutation.applied(source) != source


@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda mutation: mutation.name)
def test_named_tests_are_there(mutation: Mutation) -> None:
    """A run of a test that does not exist sees nothing."""
    for test in mutation.tests:
        file, _, name = test.partition("::")
        assert (ROOT / "tests" / file).exists(), test
        assert not name or f"def {name.split('[')[0]}(" in text(f"tests/{file}"), test
