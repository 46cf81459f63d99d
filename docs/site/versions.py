"""Several versions of the site in one folder, and the list from which each page offers them.

`FOLDER/VERSION` is a site, `FOLDER/versions.js` the list of all, `FOLDER/index.html` leads to the newest. The list is a
script, because browsers let a page opened from a file load scripts and fetch nothing. `static/versions.js` reads it.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path

from packaging.version import Version

#: The file of a site with its version and pages.
ABOUT = "versions.json"


def describe(site: Path, version: str) -> None:
    """Write the version of a built site and the names of its pages into it."""
    pages = sorted(page.relative_to(site).with_suffix("").as_posix() for page in site.rglob("*.html"))
    ours = [page for page in pages if not page.startswith("_")]
    (site / ABOUT).write_text(json.dumps({"version": version, "pages": ours}) + "\n")


def add(site: Path, folder: Path) -> Path:
    """Copy a built site into a folder of versions, in place of an earlier build, and renew the list."""
    version = json.loads((site / ABOUT).read_text())["version"]
    target = folder / version
    if target.exists():
        shutil.rmtree(target)
    shutil.copytree(site, target, ignore=shutil.ignore_patterns(".trees"))
    write_list(folder)
    return target


def write_list(folder: Path) -> None:
    """Write the list of the versions in a folder, newest first, and a page that leads to the first of them."""
    entries = [json.loads(about.read_text()) for about in folder.glob(f"*/{ABOUT}")]
    entries.sort(key=lambda entry: Version(entry["version"]), reverse=True)
    (folder / "versions.js").write_text(f"window.twistaxVersions = {json.dumps(entries)};\n")
    address = f"{entries[0]['version']}/index.html"
    refresh = f'<meta charset="utf-8"><meta http-equiv="refresh" content="0; url={address}">'
    (folder / "index.html").write_text(f'<!doctype html>{refresh}<a href="{address}">twistax</a>\n')
