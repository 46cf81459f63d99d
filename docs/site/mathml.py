"""Formulas as MathML, written at build time by docutils: browsers draw it by themselves, without scripts or network."""

from __future__ import annotations

from typing import Any

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.util import logging

log = logging.getLogger(__name__)


def _write(writer: Any, node: nodes.Node, as_block: bool) -> None:
    try:
        writer.body.append(tex2mathml(node.astext(), as_block=as_block))
    except MathError as error:
        log.warning("formula %r: %s", node.astext(), error, location=node)
    raise nodes.SkipNode


def _inline(writer: Any, node: nodes.Node) -> None:
    _write(writer, node, as_block=False)


def _block(writer: Any, node: nodes.Node) -> None:
    writer.body.append(writer.starttag(node, "div", CLASS="math"))
    try:
        writer.body.append(tex2mathml(node.astext(), as_block=True))
    except MathError as error:
        log.warning("formula %r: %s", node.astext(), error, location=node)
    writer.body.append("</div>\n")
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
