"""Picture of the page of a recorded run, in Chromium."""

import tempfile
from pathlib import Path

import browser  # of test/playing
import cv2

from documentation.play_panels import captured, resize

SIZE = (1000, 640)  # px
MOMENT = "#t=4.3"  # s, after a push


def write_view(page: Path, path: Path) -> None:
    """Write the page of a run at a moment."""
    address = page.as_uri() + MOMENT
    with (
        tempfile.TemporaryDirectory() as place,
        browser.Browser(Path(place), address) as view,
    ):
        resize(view, SIZE)
        browser.wait_for(lambda: "4.3" in view.text())
        cv2.imwrite(str(path), captured(view, None))
