"""The font of formulas, copied at build time from the package ziamath of the extra `docs`.

Browsers draw MathML well by a font with a table of mathematics alone, and few systems have one. STIX Two Math is under
the SIL Open Font License 1.1, which its own records state; `static/site.css` names the file.
"""

from __future__ import annotations

import importlib.util
import shutil
from pathlib import Path

FILE = "STIXTwoMath-Regular.ttf"
BUILT = Path(__file__).resolve().parents[2] / "build" / "fonts"


def folder() -> Path:
    """The folder with the font, made where it is not there. Raises RuntimeError without the package."""
    found = importlib.util.find_spec("ziamath")
    if found is None or not found.submodule_search_locations:
        raise RuntimeError("the site needs the font of ziamath.\n  fix: pip install 'twistax[docs]'")
    BUILT.mkdir(parents=True, exist_ok=True)
    shutil.copy(Path(found.submodule_search_locations[0]) / "fonts" / FILE, BUILT / FILE)
    return BUILT
