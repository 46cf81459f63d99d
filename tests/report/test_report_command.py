"""The command of the reports: its options, and what it says where it cannot go on."""

import importlib.util
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from twistax.__main__ import main
from twistax.report.harness.report import SectionReport

NONSENSE = {
    "--scene moon": "there is no scene 'moon'; there are euler-top, ",
    "--scene eulertop": "there is no scene 'eulertop'; did you mean euler-top?",
    "--figure": "unrecognized arguments: --figure; did you mean --figures?",
    "--method rk5": "there is no method 'rk5'; did you mean rk4?",
    "--speed --case moon": "there is no case 'moon'; there are free-body, ",
    "--figures --only moon": "there is no section 'moon'; there are identities, ",
    "--renew moon": "there is no file 'moon'",
    "--fast": "unrecognized arguments: --fast",
    "--speed --figures": "not allowed with argument",
}


@pytest.mark.parametrize("words", NONSENSE)
def test_nonsense_ends_in_one_clear_line(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["report", *words.split()])
    said = capsys.readouterr().err
    assert ended.value.code == 2
    assert said.count("\n") == 1
    assert NONSENSE[words] in said


def test_a_folder_that_cannot_be_made(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("")
    assert main(["report", "--figures", "--out", str(tmp_path / "file")]) == 2
    assert "cannot write" in capsys.readouterr().err


def test_without_jinja2_it_names_the_extra(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *rest: None if name == "jinja2" else find(name, *rest)
    )
    assert main(["report", "--figures"]) == 2
    assert "pip install 'twistax[report]'" in capsys.readouterr().err


def test_an_interrupted_run_says_how_to_go_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupt(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(SectionReport, "measure", interrupt)
    assert main(["report", "--figures", "--out", str(tmp_path)]) == 130
    assert "interrupted; repeat the command to resume" in capsys.readouterr().err


def test_options_are_read_before_anything_heavy_is_loaded() -> None:
    code = (
        "import sys, contextlib, twistax.__main__ as m\n"
        "with contextlib.suppress(SystemExit): m.main(['report', '--fast'])\n"
        "print([n for n in sys.modules if n.startswith(('diffrax', 'jinja2', 'matplotlib', 'twistax.report.harness'))])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
