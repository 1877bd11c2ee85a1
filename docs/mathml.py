"""Sphinx extension: formulas as MathML, which browsers draw themselves, without a script and without a network."""

import html
import re

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.writers.html5 import HTML5Translator

logger = logging.getLogger(__name__)

# What docutils reads in another way than LaTeX, and how it is said to it.
SAID_TO_DOCUTILS = (
    (r"'", r"^\\prime "),  # a prime is an exponent
    (r"(?<!\\left)\\lVert", r"\\left\\lVert"),  # delimiters grow with what is between them, so they come in pairs
    (r"(?<!\\right)\\rVert", r"\\right\\rVert"),
    (r"(\\(?:hat|bar|tilde|dot)\s*(?:\{[^{}]*\}|\w))(?=[_^])", r"{\1{}}"),  # an index belongs beside, not beneath
)


def mathml(latex: str, *, as_block: bool) -> str:
    """MathML of a formula.

    Raises
    ------
    MathError
        For what docutils does not know.
    """
    for pattern, said in SAID_TO_DOCUTILS:
        latex = re.sub(pattern, said, latex)
    return tex2mathml(latex, as_block=as_block).replace("&ApplyFunction;", "&#8289;")


def written(node: nodes.math | nodes.math_block) -> str:
    latex = node.astext()
    try:
        return mathml(latex, as_block=isinstance(node, nodes.math_block))
    except MathError as error:
        logger.warning("the formula %r cannot be written as MathML: %s", latex, error, location=node)
        return f"<code>{html.escape(latex)}</code>"


def visit_inline(translator: HTML5Translator, node: nodes.math) -> None:
    translator.body.append(f'<span class="math notranslate nohighlight">{written(node)}</span>')
    raise nodes.SkipNode


def visit_block(translator: HTML5Translator, node: nodes.math_block) -> None:
    opened = translator.starttag(node, "div", CLASS="math notranslate nohighlight")
    translator.body.append(f"{opened}{written(node)}</div>\n")
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    app.add_html_math_renderer("mathml", inline_renderers=(visit_inline, None), block_renderers=(visit_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
