"""Every example is a script that runs as a user would run it, without a warning."""

import json
import os
import subprocess
import sys
from pathlib import Path

EXAMPLES = sorted((Path(__file__).parent.parent / "examples").glob("*.py"))

#: Arguments of a script under which it says the same in less time: here one call is timed, not twenty.
BRIEF = {"small_matrices.py": ["--repeat", "1"]}

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


def test_examples_run(tmp_path: Path) -> None:
    environment = {**os.environ, "JAX_PLATFORMS": "cpu", "MPLBACKEND": "agg"}
    scripts = [str(path) for path in EXAMPLES]
    words = json.dumps([[str(path), *BRIEF.get(path.name, [])] for path in EXAMPLES])
    command = [sys.executable, "-W", "error", "-c", RUN, words]
    run = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, env=environment)
    assert run.returncode == 0, run.stdout + run.stderr
    assert run.stdout.splitlines() == scripts


def test_there_are_examples() -> None:
    assert len(EXAMPLES) >= 5
