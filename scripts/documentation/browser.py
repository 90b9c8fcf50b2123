"""Pages in headless Chromium."""

import shutil
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from playwright.sync_api import Locator, Page, sync_playwright

from slot_bringup.playing.page_server import address, start_server
from slot_bringup.playing.play_page import PlayPage
from slot_lab.play.played_robot import PlayedRobot

NAMES = "chromium", "google-chrome", "chromium-browser"
PROGRAM = next(filter(None, map(shutil.which, NAMES)), "")
OPTIONS = (
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--no-proxy-server",
)
SIZE = 1200, 700  # px
DEADLINE = 60.0  # s
COARSE = "?fixedDpr=0.25"  # fewer pixels of the robot, which take most of the time without a GPU


@contextmanager
def shown(address: str, size: tuple[int, int] = SIZE) -> Iterator[Page]:
    """A page in Chromium, in a window of a size, px."""
    with (
        sync_playwright() as library,
        library.chromium.launch(
            executable_path=PROGRAM, args=OPTIONS
        ) as browser,
    ):
        width, height = size
        window = browser.new_page(viewport={"width": width, "height": height})
        window.set_default_timeout(DEADLINE * 1000.0)
        window.goto(address)
        yield window


@contextmanager
def playing(place: Path, size: tuple[int, int] = SIZE):
    """The page of scripts/play, which runs, its server and a window that shows it."""
    ended, server = threading.Event(), start_server("127.0.0.1", 0, "")
    page = PlayPage(server, PlayedRobot(), place)
    runner = threading.Thread(target=page.run, args=(ended.is_set,))
    runner.start()
    try:
        site = address("127.0.0.1", server.get_port(), "") + COARSE
        with shown(site, size) as window:
            window.get_by_text("yaw rate").first.wait_for()
            yield page, server, window
    finally:
        ended.set()
        runner.join()
        server.stop()


def opened(window: Page, name: str) -> Locator:
    """A tab of the page, opened; a click may come before the page is complete."""
    tab = window.get_by_role("tab", name=name, exact=True)

    def selected():
        tab.click()
        return tab.get_attribute("aria-selected") == "true"

    wait_for(selected)
    return tab


def wait_for(find, said=str):
    """The first true result; fails after the deadline, with what is `said` then."""
    end = time.monotonic() + DEADLINE
    while not (found := find()):
        assert time.monotonic() < end, said()
        time.sleep(0.05)
    return found
