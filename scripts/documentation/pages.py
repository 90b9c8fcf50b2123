"""Pages as Sphinx reads them: generated parts filled in, links to the repository resolved.

A line `<!-- generated: NAME -->` of a page stands for a part that is made from the code when the
site is built.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path

from documentation import generated
from documentation.markdown import DOC, ROOT

MARK = re.compile(r"^<!-- generated: (\w+) -->$", re.MULTILINE)
WALK = re.compile(r"!\[([^\]]*)\]\(([^)\s]*walk)\.gif\)")  # which GitHub shows
LINK = re.compile(r"\[([^\]]*)\]\(([^)\s#]+)(#[^)\s]*)?\)")


def readme() -> str:
    """The README, for the front page; its links start at the page."""
    return _relative((ROOT / "README.md").read_text(), ROOT, DOC)


PARTS: dict[str, Callable[[], str]] = {
    "readme": readme,
    "configuration": generated.configuration,
    "results": generated.results,
}


def read(text: str, page: Path) -> str:
    """Text of a page with its generated parts and with links that the site can follow.

    page: its file. Raises ValueError for a mark of an unknown part.
    """
    return WALK.sub(_moving, _site_links(MARK.sub(_part, text), page.parent))


def _moving(image: re.Match[str]) -> str:
    """The page of the walk in the place of its picture."""
    style = "width: 100%; height: 34rem; border: 1px solid #b8c4ce"
    return f'<iframe src="{image[2]}.html" title="{image[1]}" style="{style}"></iframe>'


def _part(mark: re.Match[str]) -> str:
    if mark[1] not in PARTS:
        raise ValueError(f"generated: {mark[1]}: expected one of {', '.join(PARTS)}")
    return PARTS[mark[1]]()


def _relative(text: str, old: Path, new: Path) -> str:
    """Text whose relative links start in another folder."""

    def move(link: re.Match[str]) -> str:
        if ":" in link[2]:
            return link[0]
        return f"[{link[1]}]({os.path.relpath(old / link[2], new)}{link[3] or ''})"

    return LINK.sub(move, text)


def _site_links(text: str, folder: Path) -> str:
    """Links to the README lead to the front page; a folder is named without a link."""
    front = os.path.relpath(DOC / "index.md", folder)

    def point(link: re.Match[str]) -> str:
        target = Path(os.path.normpath(folder / link[2]))
        if target == ROOT / "README.md":
            return f"[{link[1]}]({front}{link[3] or ''})"
        return link[1] if target.is_dir() else link[0]

    return LINK.sub(point, text)
