"""The code of pages and examples, executed once: what each block prints, its last value, the files that it writes.

Results are kept by content in build/executed: the code, the source of twistax, and the versions of Python and JAX.
Tests run what is not there yet; the site and its gallery show it.
"""

from __future__ import annotations

import ast
import contextlib
import functools
import hashlib
import io
import json
import os
import re
import runpy
import shutil
import subprocess
import sys
import tempfile
import traceback
import types
from collections.abc import Iterator, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parents[2]
DOCS, EXAMPLES, KEPT = ROOT / "docs", ROOT / "examples", ROOT / "build" / "executed"
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.DOTALL | re.MULTILINE)
#: Pages that are one program: each goes on where the one before ends.
_PAGES = ("body", "rollout", "optimal", "c_code", "flight_code", "estimator")
TUTORIAL = [DOCS / "tutorial" / f"{name}.md" for name in _PAGES]
#: Arguments of a script under which it prints the same in less time.
BRIEF = {"small_matrices": ("--repeat", "1")}
#: What a block prints is cut after this many lines.
LINES = 40


class Program(NamedTuple):
    """Blocks that run one after another in one namespace; the only block of an example is its file."""

    name: str
    blocks: tuple[str, ...]
    script: str = ""
    arguments: tuple[str, ...] = ()

    @property
    def folder(self) -> Path:
        """Where its results are kept."""
        content = json.dumps([self.blocks, self.arguments, _surroundings()])
        return KEPT / f"{self.name.replace('/', '-')}-{hashlib.sha256(content.encode()).hexdigest()[:16]}"


class Output(NamedTuple):
    """Of a block: what it printed and its last value as text, the latter as LaTeX, and files that it wrote."""

    text: str
    latex: str
    files: tuple[str, ...]


def page_program(*pages: Path) -> Program:
    """The blocks of a page, or of several."""
    blocks = [block for page in pages for block in BLOCK.findall(page.read_text())]
    name = pages[0].resolve().relative_to(ROOT).with_suffix("").as_posix()
    return Program("docs/tutorial" if list(pages) == TUTORIAL else name, tuple(blocks))


def example_program(name: str) -> Program:
    """An example as a script that runs by itself."""
    path = EXAMPLES / f"{name}.py"
    return Program(f"examples/{name}", (path.read_text(),), str(path), BRIEF.get(name, ()))


def page_outputs(page: Path) -> list[Output]:
    """The results of a page's blocks, executed now where there are none. Raises RuntimeError if a block fails."""
    pages = TUTORIAL if page in TUTORIAL else [page]
    results = executed(page_program(*pages))
    before = sum(len(BLOCK.findall(other.read_text())) for other in pages[: pages.index(page)])
    return results[before : before + len(BLOCK.findall(page.read_text()))]


def executed(program: Program) -> list[Output]:
    """The results of a program, executed now where there are none. Raises RuntimeError if a block fails."""
    execute([program])
    kept = json.loads((program.folder / "outputs.json").read_text())
    return [Output(text, latex, tuple(files)) for text, latex, files in kept]


def execute(programs: Sequence[Program]) -> None:
    """Run the programs that have no results, in one process of its own. Raises RuntimeError with its traceback."""
    missing = [program for program in programs if not (program.folder / "outputs.json").exists()]
    if not missing:
        return
    paths = os.pathsep.join(filter(None, [_source_folder(), os.environ.get("PYTHONPATH")]))
    surroundings = {**os.environ, "JAX_PLATFORMS": "cpu", "MPLBACKEND": "agg", "PYTHONPATH": paths}
    jobs = json.dumps([[program._asdict(), str(program.folder)] for program in missing])
    ended = subprocess.run(
        [sys.executable, "-W", "error", __file__], input=jobs, capture_output=True, text=True, env=surroundings
    )
    if ended.returncode:
        raise RuntimeError(f"{ended.stdout[-2000:]}{ended.stderr[-6000:]}")


def _source_folder() -> str:
    import twistax

    return str(Path(twistax.__file__).resolve().parents[1])


@functools.cache
def _surroundings() -> str:
    """All that results depend on beside the code itself: twistax, this file, data of examples, Python and JAX."""
    found = hashlib.sha256(f"{sys.version_info[:2]} {metadata.version('jax')}".encode())
    folders = [Path(_source_folder()) / "twistax", EXAMPLES]
    files = [path for folder in folders for path in sorted(folder.rglob("*")) if path.is_file()]
    for path in [Path(__file__), Path(__file__).with_name("dark.py"), *files]:
        if "__pycache__" not in path.parts and not (path.parent == EXAMPLES and path.suffix == ".py"):
            found.update(path.name.encode() + path.read_bytes())
    return found.hexdigest()


# ---- within the process that runs programs ---------------------------------------------------------------------------


def _run(program: Program, folder: Path) -> None:
    """Run the blocks in an empty folder, and keep their results."""
    import jax

    jax.config.update("jax_enable_x64", False)
    work = Path(tempfile.mkdtemp(prefix="twistax_page_"))
    module = types.ModuleType("__main__" if program.script else "docs")
    if program.script:
        module.__file__ = program.script
        sys.argv = [program.script, *program.arguments]
    (work / "examples").symlink_to(EXAMPLES)
    with contextlib.chdir(work):
        outputs = [_run_block(program, block, module, work) for block in program.blocks]
    if "matplotlib.pyplot" in sys.modules:  # it warns when figures of many programs are open
        sys.modules["matplotlib.pyplot"].close("all")
    (work / "outputs.json").write_text(json.dumps(outputs))
    folder.parent.mkdir(parents=True, exist_ok=True)
    with contextlib.suppress(OSError):  # another process was faster
        shutil.move(work, folder)


def _run_block(program: Program, block: str, module: types.ModuleType, work: Path) -> Output:
    tree, before = ast.parse(block), set(work.iterdir())
    last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) and not program.script else None
    printed, value = io.StringIO(), None
    with contextlib.redirect_stdout(printed), _no_exit(program.name):
        # The `annotations` import of this file must not apply to pages.
        exec(compile(tree, program.script or program.name, "exec", dont_inherit=True), module.__dict__)
        if isinstance(last, ast.Expr):
            expression = compile(ast.Expression(last.value), program.name, "eval", dont_inherit=True)
            value = eval(expression, module.__dict__)
    latex = value._repr_latex_().strip("$") if hasattr(value, "_repr_latex_") else ""
    if hasattr(value, "savefig"):
        value.savefig(work / f"figure_{len(before)}.png", dpi=100)
    elif value is not None and not latex and set(work.iterdir()) == before:
        print(repr(value), file=printed)
    files = sorted((path for path in set(work.iterdir()) - before if path.is_file()), key=lambda path: path.name)
    return Output(printed.getvalue(), latex, tuple(path.name for path in files))


@contextlib.contextmanager
def _no_exit(name: str) -> Iterator[None]:
    """A script may end itself, without an error."""
    try:
        yield
    except SystemExit as end:
        if end.code:
            raise RuntimeError(f"{name} ends with {end.code}") from end


def main() -> int:
    import dark

    if begin := os.environ.get("TWISTAX_BEGIN"):  # settings of the tests, which change no result
        runpy.run_path(begin)
    dark.save_figures_twice()
    jobs: list[Any] = json.load(sys.stdin)
    for job, folder in jobs:
        program = Program(**job)
        try:
            _run(program._replace(blocks=tuple(program.blocks)), Path(folder))
        except BaseException:
            print(f"{program.name} failed", file=sys.stderr)
            traceback.print_exc()
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
