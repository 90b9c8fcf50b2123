"""Pictures of pages in Chromium: of scripts/play, its panels, and of a recorded run."""

import base64
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from documentation import browser

PAGE, PANELS, VIEW = (1200, 560), (1200, 2190), (1000, 640)  # px
MOMENT = 4.3  # s, of the run: after a push
TABS = "Drive", "World", "Push", "Keys", "Plots"
WALKED = 11.0  # s, so that the plots are full
# pixels of the robot
SHARP = "?fixedDpr=1"
TAB = "[...document.querySelectorAll('[role=tab]')].find(t => t.innerText == {!r})"
SHOWN = """(() => {
  let panel = document.querySelector("[role=tab]");
  while (panel.getBoundingClientRect().height < 80) panel = panel.parentElement;
  const {x, y, width, height} = panel.getBoundingClientRect();
  return {x, y, width, height, scale: 1};
})()"""
NOTICES = "document.querySelectorAll('[class*=Notification-closeButton]')"
Pixels = NDArray[np.uint8]


def write_page(path: Path) -> None:
    """Write the page as it opens, with the robot halted in its walk."""
    with walking(PAGE) as window:
        window.key("p")  # pause
        browser.wait_for(lambda: "paused" in window.text())
        window.call("Page.navigate", url=window.run("location.origin") + SHARP)
        browser.wait_for(lambda: "paused" in window.text())
        window.run(f"{NOTICES}.forEach(button => button.click())")
        begin = window.run("performance.now()")
        browser.wait_for(
            lambda: (
                not window.run(f"{NOTICES}.length")
                and window.run("performance.now()") > begin + 4000.0  # ms
            )
        )
        cv2.imwrite(str(path), captured(window, None))


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
    with (
        tempfile.TemporaryDirectory() as place,
        browser.Browser(Path(place), f"{page.as_uri()}#t={MOMENT}") as window,
    ):
        resize(window, VIEW)
        browser.wait_for(lambda: str(MOMENT) in window.text())
        cv2.imwrite(str(path), captured(window, None))


def panel(window: Any, name: str) -> Pixels:
    """Image of a panel."""
    window.click(TAB.format(name))
    browser.wait_for(
        lambda: window.run(f"{TAB.format(name)}.ariaSelected") == "true"
    )
    return captured(window, window.run(SHOWN))


def captured(window: Any, clip: Any) -> Pixels:
    """Pixels of the window, or of a part of it."""
    part = {"clip": clip} if clip else {}
    data = window.call("Page.captureScreenshot", format="png", **part)["data"]
    coded = np.frombuffer(base64.b64decode(data), np.uint8)
    return np.asarray(cv2.imdecode(coded, cv2.IMREAD_COLOR), np.uint8)


def resize(window: Any, size: tuple[int, int]) -> None:
    """Give a window a size, px."""
    width, height = size
    window.call(
        "Emulation.setDeviceMetricsOverride",
        width=width,
        height=height,
        deviceScaleFactor=1,
        mobile=False,
    )


@contextmanager
def walking(size: tuple[int, int]) -> Iterator[Any]:
    """A window of a size, px, with the page, whose robot has walked for a while."""
    with (
        tempfile.TemporaryDirectory() as place,
        browser.playing(Path(place)) as (page, _, window),
    ):
        resize(window, size)
        for key in ("w", "ArrowUp", "ArrowUp"):
            window.key(key)
        browser.wait_for(lambda: page.robot.time > WALKED)
        yield window
