"""The search of the documentation site: which result comes first, and excerpts without a network."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from test_docs import DOCS, execution, module_of_site

NODE = shutil.which("node")
SCRIPT = DOCS / "site" / "static" / "search.js"

#: What a reader types, and the address of the result that must be first.
FIRST = {
    "joint wrench": "reference/mechanics.html#twistax.mechanics.joint_wrench",
    "joint_wrench": "reference/mechanics.html#twistax.mechanics.joint_wrench",
    "RKMK": "reference/integrating.html#twistax.RKMK",
    "trim": "reference/systems.html#twistax.trim",
    "tx.integrate": "reference/integrating.html#twistax.integrate",
    "step control": "reference/integrating.html#twistax.StepControl",
    "warm start": "reference/trajectory.html#twistax.trajectory.WarmStart",
    "Problem": "reference/trajectory.html#twistax.trajectory.Problem",
    "mass matrix": "reference/mechanics.html#twistax.mechanics.mass_matrix",
    "inverse dynamics": "reference/mechanics.html#twistax.mechanics.inverse_dynamics",
    "center of mass": "reference/mechanics.html#twistax.mechanics.center_of_mass",
    "se3.exp": "reference/lie.html#twistax.lie.se3.exp",
    "Adjoint": "reference/lie.html#twistax.lie.Adjoint",
    "Problem.solve": "reference/trajectory.html#twistax.trajectory.Problem.solve",
    "zero order hold": "reference/integrating.html#twistax.ZeroOrderHold",
    "InputError": "reference/errors.html#twistax.InputError",
    "glossary": "glossary.html",
    "choose a method": "howto/choose_a_method.html",
    "mesh refinement": "trajectory.html#mesh-error-and-mesh-refinement",
    "users of MuJoCo": "for_mujoco_users.html",
}


@pytest.fixture(scope="module")
def entries() -> list[list[str]]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "execution", execution)
        patch.setitem(sys.modules, "names", module_of_site("names"))
        return [list(entry) for entry in module_of_site("search").entries()]


def by_node(expression: str, entries: list[list[str]], tmp_path: Path) -> object:
    index = tmp_path / "entries.json"
    index.write_text(json.dumps(entries))
    program = f"""
        const {{ prepare, rank, excerpt }} = require({json.dumps(str(SCRIPT))});
        const index = prepare(JSON.parse(require("fs").readFileSync({json.dumps(str(index))})));
        console.log(JSON.stringify({expression}));"""
    assert NODE is not None
    return json.loads(subprocess.run([NODE, "-e", program], capture_output=True, text=True, check=True).stdout)


@pytest.mark.skipif(NODE is None, reason="node is not installed")
def test_the_page_of_a_name_comes_first(entries: list[list[str]], tmp_path: Path) -> None:
    queries = json.dumps(list(FIRST))
    first = by_node(f"{queries}.map(query => rank(query, index)[0]?.address)", entries, tmp_path)
    assert dict(zip(FIRST, first)) == FIRST


@pytest.mark.skipif(NODE is None, reason="node is not installed")
def test_an_excerpt_marks_the_words_of_the_query(entries: list[list[str]], tmp_path: Path) -> None:
    pieces = by_node('excerpt("joint wrench", rank("joint wrench", index)[0].text)', entries, tmp_path)
    assert any(marked and text.lower().startswith("joint") for text, marked in pieces)
    assert by_node('rank("no such word xyzzy", index)', entries, tmp_path) == []


def test_the_index_is_a_script_and_holds_the_text(
    entries: list[list[str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A page opened from a file can load a script, and fetches nothing."""
    monkeypatch.setitem(sys.modules, "execution", execution)
    monkeypatch.setitem(sys.modules, "names", module_of_site("names"))
    (tmp_path / "_static").mkdir()
    module_of_site("search").write(tmp_path)
    script = (tmp_path / "_static" / "search_entries.js").read_text()
    assert script.startswith("const searchEntries = [")
    assert json.loads(script.removeprefix("const searchEntries = ").rstrip().rstrip(";")) == entries
    assert "fetch(" not in SCRIPT.read_text()
    assert sum(bool(text) for *_, text in entries) > 0.9 * len(entries)
