"""Settings of the documentation site, for Sphinx. `python docs/site` builds it."""

import os
import sys
import urllib.request
from pathlib import Path

SITE = Path(__file__).parent
sys.path.insert(0, str(SITE))
os.environ.setdefault("JAX_PLATFORMS", "cpu")

import fonts  # noqa: E402

import twistax  # noqa: E402

project = "twistax"
author = "The twistax authors"
copyright = "the twistax authors"
version = release = twistax.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.intersphinx",
    "sphinx.ext.viewcode",
    "sphinx_copybutton",
    "mathml",
    "reference",
    "results",
    "search",
]
exclude_patterns = ["site", "README.md"]
nitpicky = True

myst_enable_extensions = ["dollarmath", "colon_fence"]
myst_heading_anchors = 4
#: signatures.py writes the types, as the source has them; long signatures have a line for each argument.
autodoc_typehints = "none"
python_maximum_signature_line_length = 70
autodoc_class_signature = "mixed"
autodoc_member_order = "alphabetical"
autodoc_preserve_defaults = True
toc_object_entries_show_parents = "hide"
add_module_names = False

html_theme = "furo"
html_title = f"twistax {version}"
html_math_renderer = "mathml"
#: Besides files of this folder the font of formulas, which no commit holds.
html_static_path = ["static", str(fonts.folder())]
templates_path = ["templates"]
#: Furo's sidebar with the selector of versions (static/versions.js) below the name.
html_sidebars = {
    "**": [
        "sidebar/brand.html",
        "versions.html",
        "sidebar/search.html",
        "sidebar/scroll-start.html",
        "sidebar/navigation.html",
        "sidebar/scroll-end.html",
    ]
}
#: In place of Sphinx's search: search.py writes the index, and static/search.js ranks its entries.
html_additional_pages = {"search": "search.html"}
html_css_files = ["site.css"]
html_copy_source = False
html_show_sphinx = False
copybutton_exclude = ".linenos, .gp, .go"

#: The inventories of other projects, kept in build/ once they could be fetched.
INVENTORIES = {
    "python": "https://docs.python.org/3/",
    "numpy": "https://numpy.org/doc/stable/",
    "jax": "https://docs.jax.dev/en/latest/",
    "scipy": "https://docs.scipy.org/doc/scipy/",
    "diffrax": "https://docs.kidger.site/diffrax/",
    "equinox": "https://docs.kidger.site/equinox/",
}


def inventory(name: str, address: str) -> Path | None:
    """Its file, fetched if there is a network; without one there are no links to that project, and no warning."""
    kept = SITE.parents[1] / "build" / "inventories" / f"{name}.inv"
    if not kept.exists():
        try:
            with urllib.request.urlopen(f"{address}objects.inv", timeout=3) as answer:
                content = answer.read()
        except OSError:
            return None
        kept.parent.mkdir(parents=True, exist_ok=True)
        kept.write_bytes(content)
    return kept


_found = {name: inventory(name, address) for name, address in INVENTORIES.items()}
intersphinx_mapping = {name: (INVENTORIES[name], str(path)) for name, path in _found.items() if path}
#: Their names stay plain where there is no inventory, or none of that name in it: not all of theirs is documented.
nitpick_ignore_regex = [("py:.*", rf"({'|'.join(INVENTORIES)})\..*")]
