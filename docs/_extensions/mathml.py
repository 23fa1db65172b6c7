"""Equations as MathML, which browsers draw themselves: no script, nothing to load, pages that work offline."""

import re

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.util import logging

BARE_FRACTION = re.compile(r"\\[dt]?frac(?!\s*\{)")  # \frac12 is read as 12 over what comes next

logger = logging.getLogger(__name__)


def check(app, doctree):
    """Warn of equations that would not be drawn, or wrongly."""
    for node in doctree.findall(lambda node: isinstance(node, nodes.math | nodes.math_block)):
        tex = node.astext()
        try:
            tex2mathml(tex)
        except MathError as error:
            logger.warning(
                "Got the equation %s, but expected LaTeX that docutils knows: %s",
                tex,
                error,
                location=node,
            )
        if BARE_FRACTION.search(tex):
            logger.warning(
                "Got a fraction without braces in %s, but expected \\frac{1}{2}.",
                tex,
                location=node,
            )


def visit_math(self, node):
    """Write an equation in a line."""
    self.body.append(tex2mathml(node.astext()))
    raise nodes.SkipNode


def visit_displaymath(self, node):
    """Write an equation of its own line."""
    self.body.append(f'<div class="math">{tex2mathml(node.astext(), as_block=True)}</div>')
    raise nodes.SkipNode


def setup(app):
    """Tell Sphinx."""
    app.add_html_math_renderer("mathml", (visit_math, None), (visit_displaymath, None))
    app.connect("doctree-read", check)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
