"""Excerpts of the search where the site is opened as files, which its script may not read.

Sphinx's search fetches a page to show an excerpt of it. The script that is written here answers
from the texts of all pages in its place.
"""

from __future__ import annotations

import json
from html import escape
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

FILE = "excerpts.js"
SCRIPT = """const pages = %s;
const load = window.fetch;
window.fetch = (address, ...others) => {
  const name = String(address).replace(/^\\.?\\//, "").replace(/\\.html$/, "");
  const known = location.protocol === "file:" && name in pages;
  return known ? Promise.resolve(new Response(pages[name])) : load(address, ...others);
};
"""


def add_script(app: Sphinx, name: str, template: str, context: dict[str, Any], _: object) -> None:
    """Load the script in the page of the search."""
    if name == "search":
        app.add_js_file(FILE, priority=100)  # before the search


def write(app: Sphinx, error: Exception | None) -> None:
    """Write the script beside those of Sphinx."""
    if error is None:
        names = sorted(app.env.found_docs)
        texts = {name: escape(app.env.get_doctree(name).astext()) for name in names}
        pages = {name: f'<div role="main">{text}</div>' for name, text in texts.items()}
        (Path(app.outdir) / "_static" / FILE).write_text(SCRIPT % json.dumps(pages))
