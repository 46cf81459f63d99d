"""The reference: every public name once, from its docstring, with links from wherever a name stands in backticks.

A page asks for names by a fence: `names.py` says how. What no page has asked for, or two have, is a warning.
"""

from __future__ import annotations

import enum
import inspect
import re
from collections import Counter
from typing import Any

from docstrings import to_rst
from docutils import nodes
from names import FENCE, Name, asked, public_names
from results import output_of
from signatures import signature
from snippets import snippets
from sphinx.addnodes import desc_signature, pending_xref
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
        return [*lines, "", *_indented(example(name)), ""]
    if callable(value) and hasattr(value, "__name__"):
        return [f".. autofunction:: {name.path}", "", *_indented(example(name)), ""]
    text = to_rst([f"`{type(value).__name__}`: `{short(value)}`"], link)
    return [f".. py:data:: {name.path}", "", *(f"   {line}" for line in text), ""]


def example(name: Name) -> list[str]:
    """The example of a name: its code, what it prints, and the page where it stands if it is a statement of one."""
    snippet = snippets().get(name.path)
    if snippet is None or "Example:" in (name.value.__doc__ or ""):
        return []
    lines = ["Example:", "", ".. code-block:: python", "", *_indented(snippet.code.splitlines()), ""]
    if snippet.printed:
        lines += [".. raw:: html", "", *_indented(output_of(snippet.printed).splitlines()), ""]
    if snippet.source.startswith("docs/"):
        lines.append(f"from :doc:`/{snippet.source.removeprefix('docs/').removesuffix('.md')}`")
    elif snippet.source:
        lines.append(f"from ``{snippet.source}``")
    return lines


def _indented(lines: list[str]) -> list[str]:
    return [f"   {line}".rstrip() for line in lines]


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
_LAST = Counter(path.rpartition(".")[2] for path in _PATHS)
_SHARED = {name for name, count in _LAST.items() if count > 1}
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


def typed(app: Sphinx, what: str, path: str, value: Any, options: Any, *written: Any) -> tuple[str, str | None] | None:
    """The signature with types as the source writes them; that of an enumeration says nothing."""
    if what not in ("class", "function", "method") or not (inspect.isclass(value) or inspect.isroutine(value)):
        return None
    found = signature(value, lambda text: _unambiguous(text, inspect.getmodule(value)))
    return ("", None) if found is None else (found.arguments, found.returns)


def _unambiguous(text: str, module: Any) -> str:
    """A type whose short name two public names share, by the path of the one that the module of its function means."""
    paths = {id(name.value): name.path for name in public_names() if name.path.rpartition(".")[2] in _SHARED}

    def path(word: re.Match[str]) -> str:
        found = paths.get(id(getattr(module, word[0], None)))
        return f"~{found}" if found else word[0]

    return re.sub(r"\b[A-Z]\w+\b", path, text)


def types_in_signatures(app: Sphinx, env: Any, node: pending_xref, text: nodes.Element) -> nodes.Element | None:
    """A type in a signature leads to its entry if it is public, and is plain text if not."""
    parent = node.parent
    while parent is not None and not isinstance(parent, desc_signature):
        parent = parent.parent
    if parent is None:
        return None
    path = target(node.get("reftarget", ""))
    resolve = env.domains["py"].resolve_xref
    return (resolve(env, node["refdoc"], app.builder, "obj", path, node, text) if path in _PATHS else None) or text


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
    app.connect("autodoc-process-signature", typed)
    app.connect("missing-reference", types_in_signatures)
    app.connect("doctree-read", link_literals)
    app.connect("html-page-context", back_links)
    app.connect("env-check-consistency", check)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
