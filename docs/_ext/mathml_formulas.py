"""Formulas as MathML, which browsers draw themselves: the pages need no network."""

from docutils.nodes import SkipNode
from docutils.utils.math.latex2mathml import tex2mathml


def setup(app):
    """Register the renderer under the name that ``html_math_renderer`` gives."""
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _inline(translator, node):
    translator.body.append(str(tex2mathml(_tex(node))))
    raise SkipNode


def _block(translator, node):
    translator.body.append(f"<div>{tex2mathml(_tex(node), as_block=True)}</div>")
    raise SkipNode


def _tex(node):
    """The formula with the degree sign as TeX writes it."""
    return node.astext().replace("°", r"^\circ ")
