"""Formulas as MathML, which browsers draw themselves: the pages need no script and no network to be read."""

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.util import logging

logger = logging.getLogger(__name__)


def _formula(node, *, block):
    try:
        return tex2mathml(node.astext().strip(), as_block=block)
    except MathError as error:
        logger.warning("formula %r cannot be drawn: %s", node.astext(), error, location=node)
        return node.astext()


def inline(writer, node):
    """Write a formula inside a line."""
    writer.body.append(_formula(node, block=False))
    raise nodes.SkipNode


def block(writer, node):
    """Write a formula on a line of its own."""
    writer.body.append(f'<div class="math">{_formula(node, block=True)}</div>\n')
    raise nodes.SkipNode


def setup(app):
    """Register the renderer."""
    app.add_html_math_renderer("mathml", (inline, None), (block, None))
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
