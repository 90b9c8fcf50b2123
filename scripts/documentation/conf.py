"""Sphinx configuration of the documentation; scripts/docs builds the site."""

import dataclasses
import math
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from sphinx.application import Sphinx
from sphinx.util.rst import escape

from documentation import DOC, ROOT

project = "SLOT"
package = ElementTree.parse(ROOT / "slot_bringup" / "package.xml")
version = release = package.findtext("version") or ""
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.mathjax",
    "sphinx-mathjax-offline",  # its script and fonts are part of the site
    "sphinxcontrib.mermaid",
]
html_theme = "furo"
html_title = f"SLOT {version}"
html_copy_source = False
html_extra_path = [str(DOC / "walk.html")]  # shown in the place of walk.gif
html_static_path, html_css_files = ["site.css"], ["site.css"]
html_show_copyright = False
html_show_search_summary = False  # a browser opens files, but fetches none
# drawn here, without a script
mermaid_cmd, mermaid_output_format = ("mermaidx", "svg")
myst_enable_extensions = ["dollarmath"]
myst_fence_as_directive = ["mermaid"]  # as GitHub writes it
myst_heading_anchors = 4
add_module_names = False
autodoc_typehints = "description"

LINK = re.compile(r"\[([^\]]*)\]\(([^)\s#:]+)(#[^)\s]*)?\)")
WALK = re.compile(r"!\[([^\]]*)\]\(([^)\s]*walk)\.gif\)")  # which GitHub shows
PAGE_OF_THE_WALK = (
    r'<iframe src="\2.html" title="\1" '
    'style="width: 100%; height: 34rem; border: 1px solid #b8c4ce"></iframe>'
)


def setup(app: Sphinx) -> None:
    """Adapt the pages to the site; describe settings."""
    app.connect("source-read", read_page)
    app.connect("autodoc-process-docstring", add_settings)


def read_page(app: Sphinx, name: str, source: list[str]) -> None:
    """Put the README on the front page; links lead to pages of the site, those to folders go."""
    folder = start = Path(app.env.doc2path(name)).parent
    readme, front, text = ROOT / "README.md", DOC / "index.md", source[0]
    if name == "index":
        start, text = ROOT, readme.read_text() + text

    def site_link(link: re.Match[str]) -> str:
        target = Path(os.path.normpath(start / link[2]))
        if target.is_dir():
            return link[1]
        place = os.path.relpath(front if target == readme else target, folder)
        return f"[{link[1]}]({place}{link[3] or ''})"

    source[0] = WALK.sub(PAGE_OF_THE_WALK, LINK.sub(site_link, text))


def add_settings(
    app: Sphinx, what: str, name: str, kind: Any, *rest: Any
) -> None:
    """Append meaning, unit and bounds of the fields of a settings class to its docstring."""
    _, lines = rest
    if what == "class" and dataclasses.is_dataclass(kind):
        fields = [
            field
            for field in dataclasses.fields(kind)
            if "doc" in field.metadata
        ]
        lines += [
            f":param {field.name}: {escape(meaning(field.metadata))}"
            for field in fields
        ]


def meaning(meta: Mapping[str, Any]) -> str:
    """Text of a setting from the metadata of its field."""
    low, high = meta.get("low", -math.inf), meta.get("high", math.inf)
    bounds = ("at least", low), ("at most", high)
    limits = [
        f"{words} {value:g}" for words, value in bounds if math.isfinite(value)
    ]
    options = (
        ["one of " + ", ".join(meta["options"])] if "options" in meta else []
    )
    return "; ".join(
        filter(None, [meta["doc"], meta.get("unit"), *limits, *options])
    )
