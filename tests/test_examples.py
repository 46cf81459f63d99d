"""Every example is a script that runs as a user would run it, without a warning."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = sorted((Path(__file__).parent.parent / "examples").glob("*.py"))

#: Arguments of a script under which it says the same in less time: its programs are timed once.
BRIEF = {"small_matrices.py": ["--repeat", "1"]}

#: Processes that share the examples: JAX is imported once in each, and workers take them side by side.
SHARES = 4

#: Runs one script with its arguments after the other, each with JAX's own precision at its start.
RUN = """
import contextlib, io, json, runpy, sys
import jax

for words in json.loads(sys.argv[1]):
    script, *_ = sys.argv = words
    jax.config.update("jax_enable_x64", False)
    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(said):
            runpy.run_path(script, run_name="__main__")
    except SystemExit as end:
        assert not end.code, f"{script} ends with {end.code}"
    assert said.getvalue().strip(), f"{script} says nothing"
    print(script)
"""


@pytest.mark.parametrize("share", range(SHARES))
def test_examples_run(share: int, tmp_path: Path) -> None:
    runs = [[str(path), *BRIEF.get(path.name, [])] for path in EXAMPLES[share::SHARES]]
    environment = {**os.environ, "JAX_PLATFORMS": "cpu", "MPLBACKEND": "agg"}
    command = [sys.executable, "-W", "error", "-c", RUN, json.dumps(runs)]
    ended = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, env=environment)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert ended.stdout.splitlines() == [script for script, *_ in runs]


def test_there_are_examples() -> None:
    names = {path.name for path in EXAMPLES}
    assert len(names) >= 2 * SHARES
    assert set(BRIEF) <= names
