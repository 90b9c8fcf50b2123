"""Sphinx configuration of the documentation; scripts/docs builds the site."""

from pathlib import Path
from xml.etree import ElementTree

from docutils import nodes
from docutils.utils.math import latex2mathml
from sphinx.application import Sphinx
from sphinx.writers.html5 import HTML5Translator

from documentation import pages

BRINGUP = Path(__file__).parents[2] / "slot_bringup"

project = "SLOT"
author = "SLOT developers"
version = release = ElementTree.parse(BRINGUP / "package.xml").findtext("version") or ""
extensions = ["myst_parser", "sphinxcontrib.mermaid"]
html_theme = "furo"
html_title = f"SLOT {version}"
html_copy_source = False
html_extra_path = [str(BRINGUP / "doc" / "walk.html")]  # that pages.py shows
html_show_copyright = False
html_math_renderer = "mathml"  # by the browser itself, without a script
mermaid_cmd, mermaid_output_format = "mermaidx", "svg"  # drawn here, without a script
myst_enable_extensions = ["dollarmath"]
myst_fence_as_directive = ["mermaid"]  # as GitHub writes it
myst_heading_anchors = 4


def setup(app: Sphinx) -> None:
    """Fill in the generated parts of the pages; register the renderer of equations."""
    app.connect("source-read", read_page)
    app.add_html_math_renderer("mathml", (visit_math, None), (visit_math, None))


def read_page(app: Sphinx, name: str, source: list[str]) -> None:
    """Replace the text of a page by that of the site."""
    source[0] = pages.read(source[0], Path(app.env.doc2path(name)))


def visit_math(translator: HTML5Translator, node: nodes.math | nodes.math_block) -> None:
    """Write an equation as MathML."""
    block = isinstance(node, nodes.math_block)
    text = latex2mathml.tex2mathml(node.astext(), as_block=block)
    translator.body.append(f"<p>{text}</p>" if block else text)
    raise nodes.SkipNode
