"""The code in README and docs runs as it is printed."""

import importlib.util
import json
import pickle
import re
import sys
import tomllib
import traceback
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from matplotlib.image import imread

import twistax as tx
from twistax.errors import PAGES as PAGES_OF_PARTS

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
#: All but the kept pages of reports, which programs wrote.
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(set(DOCS.rglob("*.md")) - set(DOCS.glob("report/*.md")))]


def module_of_site(name: str) -> ModuleType:
    """A module of docs/site that needs no Sphinx."""
    spec = importlib.util.spec_from_file_location(f"site_{name}", DOCS / "site" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    sys.modules[spec.name] = module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


execution = module_of_site("execution")
TUTORIAL = execution.TUTORIAL
PROGRAMS = [[page] for page in PAGES if page not in TUTORIAL] + [TUTORIAL]
#: Those with code.
RUN = [pages for pages in PROGRAMS if execution.page_program(*pages).blocks]


def name_of(pages: list[Path]) -> str:
    return str(pages[0].relative_to(ROOT))


#: Pages that one process runs: it imports JAX once.
SHARE = 6


@pytest.mark.parametrize("pages", RUN, ids=name_of)
def test_code_blocks_run(pages: list[Path], request: pytest.FixtureRequest) -> None:
    """As a user runs them; the site shows what they print and draw."""
    names = {item.nodeid for item in request.session.items}
    here = request.node.nodeid.partition("[")[0]
    programs = [execution.page_program(*run) for run in RUN if f"{here}[{name_of(run)}]" in names]
    program = execution.page_program(*pages)
    first = programs.index(program) // SHARE * SHARE
    execution.execute(programs[first : first + SHARE])
    assert len(execution.executed(program)) == len(program.blocks)


def test_the_smoke_tier_has_the_readme() -> None:
    """By the name that its test has, which must not depend on where the checkout is."""
    names = [name_of(pages) for pages in RUN]
    smoke = tomllib.loads((ROOT / "tests/tiers.toml").read_text())["smoke"]["tests"]
    assert "test_docs.py::test_code_blocks_run[README.md]" in smoke
    assert names[0] == "README.md"


def test_the_tutorial_is_all_there() -> None:
    assert {*TUTORIAL, DOCS / "tutorial" / "index.md"} == set((DOCS / "tutorial").glob("*.md"))


def test_blocks_are_executed_once_with_what_they_print_and_draw(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(execution, "KEPT", tmp_path / "kept")
    count = tmp_path / "count"
    blocks = (
        f"with open({str(count)!r}, 'a') as file:\n    print('x', file=file)\nx = 2",
        "print('printed')\nx + 1",
        "from matplotlib.figure import Figure\nfigure = Figure()\nfigure.add_subplot().plot([1, 2])\nfigure",
        "from pathlib import Path\nPath('page.html').write_text('<p>')",
        "import twistax as tx\ntx.State('v') + 1.0",
    )
    # matplotlib warns, here an error, when more than 20 figures are open.
    figures = "import matplotlib.pyplot as plt\nfor _ in range(15):\n    plt.figure()"
    others = [execution.Program(name, (figures,)) for name in ("a script", "another")]
    execution.execute([*others, execution.Program("a page", blocks)])
    for _ in range(2):
        outputs = execution.executed(execution.Program("a page", blocks))
    assert count.read_text() == "x\n"
    assert [output.text for output in outputs] == ["", "printed\n3\n", "", "", ""]
    assert [len(output.files) for output in outputs] == [0, 0, 2, 1, 0]
    light, dark = (imread(execution.Program("a page", blocks).folder / name) for name in sorted(outputs[2].files)[::-1])
    assert light.mean() > 0.9, "black on white"
    assert dark[..., :3].mean() < 0.2
    curve = np.array([31, 119, 180]) / 255.0  # the first colour of matplotlib, in both
    assert all((np.abs(image[..., :3] - curve).max(axis=2) < 0.02).sum() > 200 for image in (light, dark))
    assert "v" in outputs[4].latex
    with pytest.raises(RuntimeError, match=r"(?s)a page failed.*ZeroDivisionError"):
        execution.executed(execution.Program("a page", ("x = 0", "1 / x")))
    with pytest.raises(RuntimeError, match="RuntimeWarning"):
        execution.executed(execution.Program("a page", ("import numpy as np\nnp.float64(1.0) / 0.0",)))


def test_pages_download_as_notebooks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A later page of the tutorial begins with the code of those before it."""
    monkeypatch.setitem(sys.modules, "execution", execution)
    notebooks = module_of_site("notebooks")
    notebooks.write(tmp_path, [TUTORIAL[1]])
    cells = json.loads((tmp_path / "tutorial" / "rollout.ipynb").read_text())["cells"]
    code = [cell["source"] for cell in cells if cell["cell_type"] == "code"]
    assert code == [block.rstrip() for block in execution.page_program(*TUTORIAL[:2]).blocks]
    texts = [cell["source"] for cell in cells if cell["cell_type"] == "markdown"]
    assert texts[0].startswith("# 2.")
    assert not any("```python" in text for text in texts)


def test_links_lead_somewhere() -> None:
    links = [(page, target) for page in PAGES for target in re.findall(r"\]\(([^)#]+)\)", page.read_text())]
    inside = [(page, target) for page, target in links if "://" not in target]
    assert len(inside) > 20
    assert [f"{page.name}: {target}" for page, target in inside if not (page.parent / target).exists()] == []


def test_files_that_are_named_exist() -> None:
    named = [
        (page, name)
        for page in PAGES
        for name in re.findall(r"`((?:src|tests|examples|docs)/[\w/.]*\w)", page.read_text())
    ]
    assert len(named) > 20
    assert [f"{page.name}: {name}" for page, name in named if not (ROOT / name).exists()] == []


def test_errors_name_pages_that_are_there() -> None:
    """The page stands in a traceback, and no part of the message."""
    waiting = [tx.TwistaxError]
    for error in waiting:
        waiting += error.__subclasses__()
    for page in [error.page for error in waiting] + list(PAGES_OF_PARTS.values()):
        name, _, place = page.partition("#")
        headings = re.findall(r"^#+ (.*)$", (ROOT / name).read_text(), re.MULTILINE)
        assert not place or place in [heading.lower().replace(" ", "-") for heading in headings], page
    assert len(waiting) > 8
    told = tx.ShapeError("no", hint="yes")
    assert str(told) == "no\n  fix: yes"
    assert traceback.format_exception(told)[-1] == "  see: docs/writing_a_system.md#expressions\n"
    assert pickle.loads(pickle.dumps(tx.ModelError("no"))).__notes__ == ["  see: docs/writing_a_system.md"]


@pytest.mark.parametrize(
    ("wrong", "page"),
    [
        (lambda: tx.view.Sphere(-1.0), "docs/howto/show.md"),
        (lambda: tx.mechanics.load("nowhere.urdf"), "docs/howto/mechanism_from_a_file.md"),
        (lambda: tx.mechanics.SpatialInertia(mass=-1.0, inertia=np.eye(3)), "docs/bodies.md"),
        (lambda: tx.mechanics.chain_models.panda().lock([]), "docs/robots.md#edit-a-mechanism"),
        (lambda: tx.StepControl(max_steps=-1), "docs/integrating.md"),
        (lambda: tx.System(rates={}), "docs/writing_a_system.md"),
        (lambda: (tx.State("x", (3,)) @ tx.State("y", (2,))).shape, "docs/writing_a_system.md#expressions"),
        (lambda: tx.lie.so3.exp(np.zeros(4)), "docs/conventions.md"),
    ],
)
def test_the_part_that_refuses_something_says_its_page(wrong: Callable[[], object], page: str, unchecked: None) -> None:
    with pytest.raises(tx.TwistaxError) as caught:
        wrong()
    assert caught.value.__notes__ == [f"  see: {page}"]


def test_every_page_is_in_the_site() -> None:
    """A page that no table of contents has is a warning, so an error, when the site is built."""
    listed = {DOCS / "index.md"}
    for page in DOCS.rglob("*.md"):
        for inside in re.findall(r"```\{toctree\}\n(.*?)```", page.read_text(), re.DOTALL):
            names = [line for line in inside.splitlines() if line and not line.startswith(":")]
            listed |= {page.parent / f"{name}.md" for name in names}
    assert set(DOCS.rglob("*.md")) == listed


def test_every_public_name_is_in_the_reference_once() -> None:
    """Add what is new to a page of docs/reference: a fence of docs/site/names.py, or a module or name in one."""
    names = module_of_site("names")
    there = Counter(
        name.path
        for page in (DOCS / "reference").glob("*.md")
        for namespace, wanted in names.FENCE.findall(page.read_text())
        for name in names.asked(namespace, wanted)
    )
    assert {name.path for name in names.public_names()} - set(there) == set(), "on no page"
    assert [path for path, count in there.items() if count > 1] == [], "on two pages"
