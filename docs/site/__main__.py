"""`python docs/site`: the documentation site into out/site, warnings as errors, every link inside it followed.

The code of pages and examples is executed first, where its results are not kept from an earlier build or a test.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import execution
import notebooks
import results
import search
import versions
from sphinx.cmd.build import build_main

import twistax

SITE = Path(__file__).parent


class _Page(HTMLParser):
    """The links of a page, and the places in it that links may lead to."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.links: list[str] = []
        self.places: set[str] = set()
        self.feed(path.read_text())

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        for name, value in attributes:
            if name == "id" and value:
                self.places.add(value)
            elif name in ("href", "src") and value:
                self.links.append(value)


def dead_links(folder: Path, also: Sequence[str] = ()) -> list[str]:
    """Links between the pages of a built site that lead nowhere, and addresses of its search."""
    folder = folder.resolve()
    drawn = folder / results.FOLDER
    files = [path for path in sorted(folder.rglob("*.html")) if drawn not in path.parents]
    pages = {path.resolve(): _Page(path) for path in files}
    dead = []
    linked = [(path, target) for path, page in pages.items() for target in page.links]
    for path, target in [*linked, *((folder / "search.html", address) for address in also)]:
        parts = urlsplit(target)
        if parts.scheme or parts.netloc:
            continue
        there = (path.parent / unquote(parts.path)).resolve() if parts.path else path
        lost = there in pages and parts.fragment and unquote(parts.fragment) not in pages[there].places
        if lost or not there.exists():
            dead.append(f"{path.relative_to(folder)}: {target}")
    return sorted(set(dead))


def _execute(processes: int) -> None:
    """Execute all programs that have no results, shared between processes."""
    programs = results.programs()
    with ThreadPoolExecutor(processes) as pool:
        list(pool.map(execution.execute, [programs[k::processes] for k in range(processes)]))


def main() -> int:
    parser = argparse.ArgumentParser(prog="python docs/site", description="Builds the documentation site.")
    parser.add_argument("--out", type=Path, default=Path("out/site"), help="folder for the pages (./out/site)")
    parser.add_argument("--versions", type=Path, help="folder of several versions, into which the site is copied")
    parser.add_argument("--external", action="store_true", help="follow links to other sites instead; needs a network")
    given = parser.parse_args()
    begun = time.perf_counter()
    builder = "linkcheck" if given.external else "html"
    # Warnings are errors, and each one is told.
    options = ["-q", "-W", "-n", "-j", "auto", "-b", builder, "-c", str(SITE), "-d", str(given.out / ".trees")]
    if (given.out / ".trees").exists():
        shutil.rmtree(given.out)  # of an earlier build: pages and entries may be gone
    if not given.external:
        _execute(2)
    failed = build_main([*options, str(SITE.parent), str(given.out)])
    if failed or given.external:
        return failed
    results.copy_files(given.out)
    notebooks.write(given.out / results.NOTEBOOKS, results.pages())
    versions.describe(given.out, twistax.__version__)
    found = search.write(given.out)
    dead = dead_links(given.out, [entry.address for entry in found])
    for link in dead:
        print(f"leads nowhere: {link}", file=sys.stderr)
    if given.versions and not dead:
        versions.add(given.out, given.versions)
    count = len(list(given.out.rglob("*.html")))
    print(f"{count} pages in {time.perf_counter() - begun:.0f} s: {given.out / 'index.html'}")
    return 1 if dead else 0


if __name__ == "__main__":
    sys.exit(main())
