"""Pictures of pages in Chromium: of scripts/play, its panels, and of a recorded run."""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from playwright.sync_api import Page

from documentation import browser

PAGE, PANELS, VIEW = (1200, 560), (1200, 2600), (1000, 640)  # px
MOMENT = 4.3  # s, of the run: after a push
TABS = "Drive", "World", "Push", "Keys", "Plots"
WALKED = 11.0  # s, so that the plots are full
# pixels of the robot
SHARP = "?fixedDpr=1"
# the smallest element with a tab that is more than the row of tabs
PANEL = """tab => {
  while (tab.getBoundingClientRect().height < 80) tab = tab.parentElement;
  return tab;
}"""
NOTICES = "[class*=Notification-closeButton]"
SETTLED = 4000.0  # ms
Pixels = NDArray[np.uint8]


def write_page(path: Path) -> None:
    """Write the page as it opens, with the robot halted in its walk."""
    with walking(PAGE) as window:
        window.keyboard.press("p")  # pause
        window.get_by_text("paused").first.wait_for()
        window.goto(window.evaluate("location.origin") + SHARP)
        window.get_by_text("paused").first.wait_for()
        window.wait_for_timeout(SETTLED)
        for notice in window.locator(NOTICES).all():
            notice.click()
        window.wait_for_timeout(SETTLED)
        window.screenshot(path=path)


def write_panels(path: Path) -> None:
    """Write the panels below each other, the plots beside them."""
    with walking(PANELS) as window:
        *panels, plots = [panel(window, name) for name in TABS]
    left = np.vstack(panels)
    below = len(plots) - len(left)
    left = np.pad(left, ((0, below), (0, 0), (0, 0)), constant_values=255)
    cv2.imwrite(str(path), np.hstack([left, plots]))


def write_view(page: Path, path: Path) -> None:
    """Write the page of a run at a moment."""
    with browser.shown(f"{page.as_uri()}#t={MOMENT}", VIEW) as window:
        window.get_by_text(str(MOMENT)).first.wait_for()
        window.screenshot(path=path)


def panel(window: Page, name: str) -> Pixels:
    """Image of a panel."""
    tab = browser.opened(window, name)
    shown = tab.evaluate_handle(PANEL).as_element()
    assert shown
    coded = np.frombuffer(shown.screenshot(), np.uint8)
    return np.asarray(cv2.imdecode(coded, cv2.IMREAD_COLOR), np.uint8)


@contextmanager
def walking(size: tuple[int, int]) -> Iterator[Page]:
    """A window of a size, px, with the page, whose robot has walked for a while."""
    with (
        tempfile.TemporaryDirectory() as place,
        browser.playing(Path(place), size) as (page, _, window),
    ):
        for key in ("w", "ArrowUp", "ArrowUp"):
            window.keyboard.press(key)
        browser.wait_for(lambda: page.robot.time > WALKED)
        yield window
