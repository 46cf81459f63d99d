"""What the demo's command line takes, and the one line it answers nonsense with."""

import math
import platform
import re
import tomllib
from importlib import metadata
from pathlib import Path

import jax
import numpy as np
import pytest

from twistax.__main__ import EXTRAS, main
from twistax.demo.options import parse_start
from twistax.scenes.powered_descent import Start


def test_a_start_spelled_out_is_the_default() -> None:
    text = "height=900,offset=400:150,velocity=-60:-20:-100,tilt=60,axis=-0.2:-1:0,righting=4.6"
    start, default = parse_start(text), Start()
    assert (start.height, start.offset, start.velocity) == (default.height, default.offset, default.velocity)
    assert start.tilt_axis == default.tilt_axis
    assert start.tilt == pytest.approx(default.tilt)
    assert start.righting == pytest.approx(default.righting)


def test_what_is_left_out_keeps_its_default() -> None:
    start = parse_start(" tilt = 20 , offset=-3:4.5")
    assert start.tilt == pytest.approx(math.radians(20.0))
    assert start.offset == (-3.0, 4.5)
    assert start.height == Start().height


NONSENSE = {
    "--initial hight=900": "hight=900' is not one of height",
    "--initial height": "'height' is not one of height",
    "--initial height=tall": "height expects a number, got 'tall'",
    "--initial height=nan": "height expects a number, got 'nan'",
    "--initial height=-5": "height must be above zero, got -5",
    "--initial offset=1:2:3": "offset expects 2 numbers separated by colons",
    "--initial velocity=1:2": "velocity expects 3 numbers separated by colons",
    "--initial velocity=1e300:0:0": "no entry may exceed 1e6",
    "--initial tilt=200": "tilt must be from 0 to 180 degrees, got 200",
    "--initial axis=0:0:0": "axis must not be zero",
    "--initial tilt=1,tilt=2": "tilt occurs twice",
    "--guess-seed -1": "expects a whole number from 0",
    "--guess-seed x": "expects a whole number from 0",
    "--nodes 3": "expects a whole number from 5 to 200, got '3'",
    "--nodes many": "expects a whole number from 5 to 200, got 'many'",
    "--max-iterations 0": "expects a whole number from 1",
    "--colour red": "twistax demo: unrecognized arguments",
    "--node 12": "did you mean --nodes?",
}


@pytest.mark.parametrize("words", NONSENSE)
def test_nonsense_ends_in_one_clear_line(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["demo", *words.split()])
    said = capsys.readouterr().err
    assert ended.value.code == 2
    assert said.count("\n") == 1
    assert NONSENSE[words] in said


def test_an_unknown_command_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["fly"])
    assert ended.value.code == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_without_a_command_it_says_what_one_can_do(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    said = capsys.readouterr().out
    assert all(word in said for word in ("demo", "report", "--version", "docs/index.md"))


def test_versions(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """All that takes part, and an extra only where all of its packages are there."""
    known = {"llvmlite": "0.45.0", "jinja2": "3.1.6"}
    missing = {"matplotlib", "casadi"}
    real = metadata.version

    def version(package: str) -> str:
        if package in missing:
            raise metadata.PackageNotFoundError(package)
        return known.get(package) or real(package)

    monkeypatch.setattr(metadata, "version", version)
    assert main(["--version"]) == 0
    said = capsys.readouterr().out
    for word in (
        "twistax 0.",
        platform.python_version(),
        f"jax {jax.__version__}",
        f"numpy {np.__version__}",
        "backend cpu",
    ):
        assert word in said
    assert "extra native: llvmlite 0.45.0" in said
    lacking = said.partition("extras not installed: ")[2].split("\n")[0].split(", ")
    assert {"plot", "casadi", "report"} <= set(lacking)


def test_versions_name_the_packages_of_the_extras() -> None:
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
    # Those of developers are left out.
    assert set(EXTRAS) == set(project["optional-dependencies"]) - {"test", "gpu-test", "openscvx", "peers", "all"}
    for extra, packages in EXTRAS.items():
        named = {re.match(r"[\w-]+", line)[0] for line in project["optional-dependencies"][extra]}
        assert set(packages) <= named


def test_a_folder_that_cannot_be_made(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("")
    assert main(["demo", "--out", str(tmp_path / "file")]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "cannot write" in said


def test_help_documents_the_start_and_the_perturbation(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["demo", "--help"])
    said = capsys.readouterr().out
    assert ended.value.code == 0
    for word in ("height=900", "velocity", "righting", "+- 40 m", "--nodes", "--out"):
        assert word in said


def test_examples_are_copied_and_nothing_is_written_over(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "new" / "examples"
    assert main(["examples", str(out)]) == 0
    assert "free_body.py" in capsys.readouterr().out
    source = Path(__file__).parents[2] / "examples"
    for name in ("free_body.py", "panda.py", "panda.urdf"):
        assert (out / name).read_bytes() == (source / name).read_bytes()
    (out / "free_body.py").write_text("mine")
    assert main(["examples", "--out", str(out)]) == 2
    assert " exists; name another folder" in capsys.readouterr().err
    assert (out / "free_body.py").read_text() == "mine"
    (tmp_path / "file").write_text("")
    assert main(["examples", "--out", str(tmp_path / "file" / "below")]) == 2
    assert "cannot write to" in capsys.readouterr().err
