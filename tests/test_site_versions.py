"""The selector of versions of the documentation site, from files and without a network."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from test_docs import DOCS, module_of_site

NODE = shutil.which("node")
CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
SCRIPT = DOCS / "site" / "static" / "versions.js"
PAGE = (DOCS / "site" / "templates" / "versions.html").read_text()


def site(folder: Path, version: str, pages: tuple[str, ...]) -> Path:
    """A site of empty pages with the selector, as Sphinx fills in its template."""
    for page in pages:
        root = "../" * page.count("/") or "./"
        text = re.sub(r"\{\{ pathto\('([^']*)', 1\) \}\}", rf"{root}\1", PAGE)
        values = {"content_root": root, "pagename": page, "version": version}
        text = re.sub(r"\{\{ (\w+) \}\}", lambda found, values=values: values[found[1]], text)
        assert "{{" not in text
        (folder / f"{page}.html").parent.mkdir(parents=True, exist_ok=True)
        (folder / f"{page}.html").write_text(text)
    (folder / "_static").mkdir()
    shutil.copy(SCRIPT, folder / "_static" / "versions.js")
    module_of_site("versions").describe(folder, version)
    return folder


def options(page: Path, tmp_path: Path) -> list[tuple[str, str]]:
    """The options of the selector, version and address, as a browser shows the page from its file."""
    assert CHROMIUM is not None
    command = [CHROMIUM, "--headless=new", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}"]
    command += ["--virtual-time-budget=5000", "--dump-dom", page.as_uri()]
    dom = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True).stdout
    return [(text, address) for address, text in re.findall(r'<option(?: value="([^"]*)")?[^>]*>([^<]*)</option>', dom)]


def test_versions_are_listed_newest_first_with_their_pages(tmp_path: Path) -> None:
    versions = module_of_site("versions")
    folder = tmp_path / "all"
    for version, pages in [("0.9.0", ("index",)), ("0.10.0.dev0", ("index", "howto/show")), ("0.10.0", ("index",))]:
        versions.add(site(tmp_path / version, version, pages), folder)
    listed = json.loads((folder / "versions.js").read_text().removeprefix("window.twistaxVersions = ").rstrip(";\n"))
    assert [entry["version"] for entry in listed] == ["0.10.0", "0.10.0.dev0", "0.9.0"]
    assert listed[1]["pages"] == ["howto/show", "index"]
    assert 'url=0.10.0/index.html"' in (folder / "index.html").read_text()


@pytest.mark.skipif(NODE is None, reason="node is not installed")
def test_another_version_is_offered_at_the_same_page_where_it_has_it() -> None:
    listed = [{"version": "2", "pages": ["index", "howto/show"]}, {"version": "1", "pages": ["index"]}]
    call = f"choices({json.dumps(listed)}, 'PRESENT', '../', 'howto/show')"
    program = f"const {{ choices }} = require({json.dumps(str(SCRIPT))}); console.log(JSON.stringify({call}));"

    def choices(present: str) -> list[tuple[str, str, bool]]:
        assert NODE is not None
        run = [NODE, "-e", program.replace("PRESENT", present)]
        listed_options = json.loads(subprocess.run(run, capture_output=True, text=True, check=True).stdout)
        return [(option["version"], option["address"], option["selected"]) for option in listed_options]

    assert choices("1") == [("2", "../../2/howto/show.html", False), ("1", "", True)]
    assert choices("2") == [("2", "", True), ("1", "../../1/index.html", False)]
    # A version that the list does not have yet, such as a build of a branch, comes first.
    assert choices("3.dev0")[0] == ("3.dev0", "", True)


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed")
def test_the_selector_works_from_files_and_alone_shows_the_present_version(tmp_path: Path) -> None:
    versions = module_of_site("versions")
    alone = site(tmp_path / "alone", "2.0", ("index", "howto/show"))
    assert options(alone / "howto" / "show.html", tmp_path) == [("2.0", "")]
    folder = tmp_path / "all"
    versions.add(alone, folder)
    versions.add(site(tmp_path / "old", "1.0", ("index", "howto/show")), folder)
    page = folder / "2.0" / "howto" / "show.html"
    (newest, here), (older, address) = options(page, tmp_path)
    assert (newest, here, older) == ("2.0", "", "1.0")
    assert (page.parent / address).resolve() == folder / "1.0" / "howto" / "show.html"
