"""Sphinx configuration of the documentation; scripts/docs builds the site."""

from pathlib import Path
from xml.etree import ElementTree

from sphinx.application import Sphinx

from documentation import excerpts, pages

BRINGUP = Path(__file__).parents[2] / "slot_bringup"

project = "SLOT"
author = "SLOT developers"
version = release = ElementTree.parse(BRINGUP / "package.xml").findtext("version") or ""
extensions = [
    "myst_parser",
    "sphinx.ext.mathjax",
    "sphinx-mathjax-offline",  # its script and fonts are part of the site
    "sphinxcontrib.mermaid",
]
html_theme = "furo"
html_title = f"SLOT {version}"
html_copy_source = False
html_extra_path = [str(BRINGUP / "doc" / "walk.html")]  # that pages.py shows
html_static_path, html_css_files = ["site.css"], ["site.css"]
html_show_copyright = False
mermaid_cmd, mermaid_output_format = "mermaidx", "svg"  # drawn here, without a script
myst_enable_extensions = ["dollarmath"]
myst_fence_as_directive = ["mermaid"]  # as GitHub writes it
myst_heading_anchors = 4


def setup(app: Sphinx) -> None:
    """Fill in the generated parts of the pages; give the search its excerpts."""
    app.connect("source-read", read_page)
    app.connect("html-page-context", excerpts.add_script)
    app.connect("build-finished", excerpts.write)


def read_page(app: Sphinx, name: str, source: list[str]) -> None:
    """Replace the text of a page by that of the site."""
    source[0] = pages.read(source[0], Path(app.env.doc2path(name)))
