"""The reference: every public name once, from its docstring, with links from wherever a name stands in backticks.

A page asks for names by a fence: `names.py` says how. What no page has asked for, or two have, is a warning.
"""

from __future__ import annotations

import enum
import inspect
import re
from typing import Any

from docstrings import to_rst
from docutils import nodes
from names import FENCE, Name, asked, public_names
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.util import logging

from twistax.expr import Expr

log = logging.getLogger(__name__)
#: Namespaces elsewhere whose names become links.
OTHERS = ("jax", "numpy", "diffrax", "scipy", "equinox")


def expand(app: Sphinx, page: str, source: list[str]) -> None:
    """Fences of names become directives of autodoc."""

    def directives(fence: re.Match[str]) -> str:
        found = asked(fence[1], fence[2])
        if not found:
            log.warning("no public names %s in %s", fence[2].split(), fence[1], location=page)
        return "```{eval-rst}\n" + "\n".join(line for name in found for line in entry(name)) + "\n```"

    source[0] = FENCE.sub(directives, source[0])


def entry(name: Name) -> list[str]:
    """The directive of one name, with its methods."""
    value = name.value
    if inspect.isclass(value):
        lines = [f".. autoclass:: {name.path}"]
        members = [*value.__members__, *name.members()] if issubclass(value, enum.Enum) else name.members()
        if members:
            lines += [f"   :members: {', '.join(members)}", "   :undoc-members:"]
        return [*lines, ""]
    if callable(value) and hasattr(value, "__name__"):
        return [f".. autofunction:: {name.path}", ""]
    text = to_rst([f"`{type(value).__name__}`: `{short(value)}`"], link)
    return [f".. py:data:: {name.path}", "", *(f"   {line}" for line in text), ""]


def short(value: Any) -> str:
    """A value as it prints; of a long tuple the names of what is in it."""
    text = repr(value)
    if isinstance(value, tuple) and all(hasattr(part, "name") for part in value):
        return ", ".join(part.name for part in value)
    return text if len(text) < 200 else f"{text[:200]} ..."


_PATHS = {name.path for name in public_names()}
_SHORT: dict[str, str] = {}
for _name in public_names():
    _SHORT.setdefault(_name.path.rpartition(".")[2], _name.path)
_MEMBERS = {f"{name.path}.{member}" for name in public_names() for member in name.members()}


def target(text: str) -> str | None:
    """The full path of what stands in backticks, where it is a public name, a method of one, or another package's."""
    text = re.sub(r"^tx\.", "twistax.", text.removesuffix("()"))
    if text in _PATHS or text in _MEMBERS:
        return text
    first, dot, rest = text.partition(".")
    if first in _SHORT and (not dot or f"{_SHORT[first]}.{rest}" in _MEMBERS):
        return _SHORT[first] + dot + rest
    return text if first in OTHERS and re.fullmatch(r"\w+(\.\w+)+", text) else None


def link(text: str) -> str:
    """Code in a docstring, as reStructuredText; a link where it is a name."""
    found = target(text) if re.fullmatch(r"[\w.]+(\(\))?", text) else None
    return f":py:obj:`{text} <{found}>`" if found else f"``{text}``"


def docstring(app: Sphinx, what: str, path: str, value: Any, options: Any, lines: list[str]) -> None:
    """A docstring as reStructuredText, a node's with the formula that notebooks show."""
    also = public_bases(value) if what == "class" else []
    if also:
        lines += ["", f"Has what `{also[0]}` has, too."]
    lines[:] = to_rst(lines, link)
    formula = formula_of(value) if what == "class" else None
    if formula:
        at = lines.index("") + 1
        lines[at:at] = [f".. math:: {formula}", ""]


def public_bases(value: type) -> list[str]:
    """The nearest base class that has an entry of its own, in a list; the page of the nodes tells of theirs."""
    public = {
        name.value: name.path for name in public_names() if inspect.isclass(name.value) and name.value is not Expr
    }
    return [public[base] for base in value.__mro__[1:] if base in public][:1]


def formula_of(value: Any) -> str | None:
    """The LaTeX of the first example of a node."""
    own = next((name for name in public_names() if name.value is value and name.is_node), None)
    try:
        return next(case.expr.latex() for case in value.example() if type(case.expr) is value) if own else None
    except (NotImplementedError, StopIteration):
        return None


def link_literals(app: Sphinx, tree: nodes.document) -> None:
    """`tx.integrate` in a page leads to its entry. Short names alone are left: they may be anybody's."""
    page = app.env.docname
    for literal in list(tree.findall(nodes.literal)):
        text = literal.astext()
        if not text.startswith("tx.") or isinstance(literal.parent, (nodes.reference, pending_xref)):
            continue
        found = target(re.split(r"[(\[ ]", text)[0])
        if found:
            reference = pending_xref(
                "", refdomain="py", reftype="obj", reftarget=found, refexplicit=True, refwarn=True, refdoc=page
            )
            literal.replace_self(reference)
            reference += literal


def check(app: Sphinx, env: Any) -> None:
    """Every public name is in the reference, once. Sphinx itself warns of what is there twice."""
    there = set(env.domains["py"].objects)
    for path in sorted(_PATHS - there):
        log.warning("%s is on no page of the reference", path)


def back_links(app: Sphinx, page: str, template: str, context: dict[str, Any], tree: Any) -> None:
    """Pages of code lead back to entries; viewcode takes one namespace for all of a module, and some are in two."""
    if page.startswith("_modules/") and "body" in context:
        known = app.env.domains["py"].objects
        back = r'<a class="viewcode-back" href="[^"]*#([^"]*)">.*?</a>'
        context["body"] = re.sub(back, lambda link: link[0] if link[1] in known else "", context["body"])


def setup(app: Sphinx) -> dict[str, bool]:
    app.connect("source-read", expand)
    app.connect("autodoc-process-docstring", docstring)
    app.connect("doctree-read", link_literals)
    app.connect("html-page-context", back_links)
    app.connect("env-check-consistency", check)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
