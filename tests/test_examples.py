"""Every example is a script that runs as a user would run it, without a warning."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = sorted((Path(__file__).parent.parent / "examples").glob("*.py"))

#: Arguments of a script under which it says the same in less time: one program of four, and one call of it is timed.
BRIEF = {"small_matrices.py": ["--repeat", "1", "--issue", "26145"]}

#: Scripts that the default tier runs as far as their first solve or integration: its arguments are checked. What these
#: compile takes most of the time, which the slow test, run in CI too, does to the end.
STATED = [
    "four_bar.py",
    "landing.py",
    "payload.py",
    "quadruped.py",
    "receding_horizon.py",
    "staged_rocket.py",
    "switching_times.py",
]

#: Runs one script with its arguments after the other, each with JAX's own precision at its start.
RUN = """
import contextlib, inspect, io, json, os, runpy, sys
import jax
import twistax as tx

class Reached(Exception):
    pass

def reached(function):
    signature = inspect.signature(function)
    def call(*args, **kwargs):
        signature.bind(*args, **kwargs)
        raise Reached
    return call

whole = tx.integrate, tx.integrate_phases, tx.trajectory.Problem.solve
runs, stated = json.loads(sys.argv[1])
for words in runs:
    script, *_ = sys.argv = words
    short = os.path.basename(script) in stated
    short_or_whole = map(reached, whole) if short else whole
    tx.integrate, tx.integrate_phases, tx.trajectory.Problem.solve = short_or_whole
    jax.config.update("jax_enable_x64", False)
    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(said):
            runpy.run_path(script, run_name="__main__")
        assert not short, f"{script} solves and integrates nothing"
    except Reached:
        said.write("as far as that")
    except SystemExit as end:
        assert not end.code, f"{script} ends with {end.code}"
    assert said.getvalue().strip(), f"{script} says nothing"
    print(script)
"""


def run(words: list[list[str]], stated: list[str], folder: Path) -> None:
    environment = {**os.environ, "JAX_PLATFORMS": "cpu", "MPLBACKEND": "agg"}
    command = [sys.executable, "-W", "error", "-c", RUN, json.dumps([words, stated])]
    ended = subprocess.run(command, capture_output=True, text=True, cwd=folder, env=environment)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert ended.stdout.splitlines() == [script for script, *_ in words]


def test_examples_run(tmp_path: Path) -> None:
    assert {*STATED, *BRIEF} <= {path.name for path in EXAMPLES}
    run([[str(path), *BRIEF.get(path.name, [])] for path in EXAMPLES], STATED, tmp_path)


@pytest.mark.slow
def test_long_examples_run_to_their_ends(tmp_path: Path) -> None:
    run([[str(path)] for path in EXAMPLES if path.name in {*STATED, *BRIEF}], [], tmp_path)


def test_there_are_examples() -> None:
    assert len(EXAMPLES) >= 5
